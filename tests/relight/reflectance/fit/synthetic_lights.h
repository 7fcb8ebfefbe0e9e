// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"

/// @file
/// Lights and pictures whose fit is known.

namespace haarlight::testing {

/// Directions spread evenly over the hemisphere above `lowest` (z), by the golden angle.
inline std::vector<Eigen::Vector3d> spiral_lights(int n, double lowest = 0.2) {
  std::vector<Eigen::Vector3d> lights;
  for (int i = 0; i < n; ++i) {
    const double z = lowest + (1.0 - lowest) * (i + 0.5) / n;
    const double phi = i * std::numbers::pi * (3.0 - std::sqrt(5.0));
    const double rho = std::sqrt(1.0 - z * z);
    lights.emplace_back(rho * std::cos(phi), rho * std::sin(phi), z);
  }
  return lights;
}

/// A smooth field between -1 and 1 that differs from term to term and from channel to channel.
inline double field(int x, int y, int term, int channel) {
  return std::sin(0.31 * x + 1.3 * term + 0.4 * channel) *
         std::cos(0.23 * y - 0.7 * term + channel);
}

}  // namespace haarlight::testing
