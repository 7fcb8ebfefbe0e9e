// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "haarlight/render/light/cubemap.h"

/// @file
/// The lighting of a picture: an environment, or lights named one by one.

namespace haarlight::relight {

struct LightChoice {
  std::string cubemap;              ///< environment; empty: none
  std::vector<std::string> lights;  ///< words for weights_from_words()
  double rotate_deg = 0.0;  ///< of the environment about z, counter-clockwise from above
};

/// The environment, rotated.
/// @throws Error  as Environment::read
[[nodiscard]] render::Environment read_environment(const LightChoice& choice);

/// An environment from a picture file's bytes. @param name  for errors
/// @throws Error  as Environment::read
[[nodiscard]] render::Environment environment_from_bytes(std::string_view bytes,
                                                         const std::string& name);

}  // namespace haarlight::relight
