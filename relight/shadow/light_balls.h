// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/light_tree.h"

/// @file
/// A root's lights in small groups of neighbours, which an occluder often hides or leaves clear as
/// a whole (Occluder::look_at_all).

namespace haarlight::relight {

/// Holds all of its lights.
struct LightBall {
  Eigen::Vector3d centre;  ///< world
  double radius_mm;
};

struct LightBalls {
  std::vector<LightBall> balls;
  std::vector<std::size_t> of_leaf;  ///< in the order of LightRoot::leaves
};

/// At most sixteen lights per ball: the root's blocks of 4 x 4.
[[nodiscard]] LightBalls light_balls(const render::LightRoot& root);

}  // namespace haarlight::relight
