// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "render/surface/irradiance_octree.h"
#include "render/surface/path_integrator.h"

/// @file
/// A record of the irradiance cache from what rays over a hemisphere find.

namespace haarlight::render {

/// Cells of the hemisphere about z that receive the same from an even sky: n_high of sin^2 theta, each
/// cut into n_around of the angle about z.
struct HemisphereCells {
  int n_high = 0;
  int n_around = 0;

  /// About as wide as high [Ward92]. @param n_rays  as many or a few less, at least 4
  [[nodiscard]] static HemisphereCells of(int n_rays);

  [[nodiscard]] int size() const { return n_high * n_around; }
  [[nodiscard]] std::size_t number(int high, int around) const {
    return static_cast<std::size_t>(high) * static_cast<std::size_t>(n_around) +
           static_cast<std::size_t>(around);
  }
  /// @param cell  around first @param square  in it, in [0, 1)^2 @return a unit vector
  [[nodiscard]] Eigen::Vector3d direction(int cell, const Eigen::Vector2d& square) const;
};

/// What the radius of a record may be, mm, before it is multiplied by the accuracy.
struct RadiusLimits {
  double least_mm = 0.0;
  double most_mm = 0.0;
};

/// A record of a point.
/// @param world_from_local  the frame of the cells; its last column is the normal
/// @param found     by cell: (cells.size(),)
/// @param accuracy  a in R = a clamp(harmonic mean of the distances, least, most), which is no larger
///                  than the shortest distance either, or than a times the least
[[nodiscard]] IrradianceRecord record_of(const Eigen::Vector3d& point,
                                         const Eigen::Matrix3d& world_from_local,
                                         const HemisphereCells& cells,
                                         std::span<const PathIntegrator::Gathered> found,
                                         double accuracy, const RadiusLimits& limits);

}  // namespace haarlight::render
