// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include <Eigen/Core>

/// @file
/// Irradiance from a disk in closed form: Lambert's contour integral [Lambert1760] around its rim.

namespace haarlight::render {

/// Emits from its front.
struct EmittingDisk {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, of the front
  double radius_mm = 1.0;
};

/// Irradiance at `point` on a surface of normal `normal` from a disk of radiance 1; 0 behind it. Nothing: the disk is not all above the surface's horizon. 1e-14
/// relative, but for a disk that stands upright on the horizon. @param normal  unit. Pure.
[[nodiscard]] std::optional<double> disk_irradiance(const EmittingDisk& disk,
                                                    const Eigen::Vector3d& point,
                                                    const Eigen::Vector3d& normal);

}  // namespace haarlight::render
