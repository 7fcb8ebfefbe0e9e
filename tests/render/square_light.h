// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/render/analytic/polygon_light.h"

/// @file
/// A square light for tests, facing down.

namespace haarlight::testing {

inline render::SquareLight square(const Eigen::Vector3d& centre, double size, double mu = 1.0) {
  render::SquareLight light;
  light.centre = centre;
  light.width_mm = size;
  light.height_mm = size;
  light.lobe_mu = mu;
  return light;
}

}  // namespace haarlight::testing
