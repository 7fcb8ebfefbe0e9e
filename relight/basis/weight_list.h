// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

/// @file
/// Light weights as users write them: on the command line and in a JSON file.

namespace haarlight::relight {

/// "528" or "528=0.5", several after one another or in one text with commas. Lights named twice
/// add up.
/// @return  (n_lights, 1)
/// @throws Error(usage)  not a number, no such light
[[nodiscard]] Eigen::MatrixXd weights_from_words(const std::vector<std::string>& words,
                                                 int n_lights,
                                                 const std::string& where = "command line");

/// A JSON list of one number or [r, g, b] per light; rows of a face may be nested lists.
/// @return  (n_lights, 1 or 3)
/// @throws Error  not such a list, a wrong number of lights, a number that is not finite
[[nodiscard]] Eigen::MatrixXd weights_from_json(const std::filesystem::path& file,
                                                int n_lights);
/// The same of such a text. @param where  for errors
[[nodiscard]] Eigen::MatrixXd weights_from_json_text(std::string_view text,
                                                     const std::string& where, int n_lights);

}  // namespace haarlight::relight
