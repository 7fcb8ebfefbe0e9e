// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "relight/study/array_grid.h"
#include "relight/study/capture_regions.h"

/// @file
/// The lightings under which bases are compared: one light, four and nine side by side, a
/// smooth lobe, and a high-frequency sky. Definitions: docs/numerics/bases.md, "Lightings".

namespace haarlight::relight {

struct StudyLighting {
  std::string name;
  Eigen::VectorXd weights;  ///< weight of each light
};

/// On a grid: light (13/32 of the rows, 19/32 of the columns) of the first face, and its
/// neighbours; otherwise the light 13/32 through the list and the nearest ones by direction.
/// Sets with more lights than available are left out.
[[nodiscard]] std::vector<StudyLighting> default_lightings(
    const std::vector<Eigen::Vector3d>& directions, const ArrayGrid& grid);

/// A JSON object: name -> one number per light; rows of a face may be nested lists.
/// @throws Error  not such an object, a wrong number of lights, a number that is not finite
[[nodiscard]] std::vector<StudyLighting> lightings_from_json(const std::filesystem::path& file,
                                                             int n_lights);

}  // namespace haarlight::relight
