// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

/// @file
/// A flat rectangular light, as an LED behind its diffuser. Lengths in mm, world frame.

namespace haarlight::render {

/// A flat rectangular emitter.
struct SquareLight {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();  ///< unit
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();  ///< unit
  Eigen::Vector3d emits = -Eigen::Vector3d::UnitZ();
  double width_mm = 1.0;   ///< along u
  double height_mm = 1.0;  ///< along v
  double radiance = 1.0;   ///< along the normal
  double lobe_mu = 1.0;    ///< radiance ~ cos^(mu - 1) of the angle to `emits`
};

}  // namespace haarlight::render
