// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "relight/reflectance/fit/light_sample.h"

/// @file
/// The few combinations of lights and colours that carry most of a capture's appearance under
/// any light: PCA of the pixels' values interpolated at the nodes (RBF centres or grid points).
/// Pure.

namespace haarlight::relight {

struct LightAxes {
  Eigen::MatrixXd matrix;  ///< (n_planes, 3 * n_lights): a pixel's planes
  Eigen::VectorXd added;   ///< (n_planes)
  Eigen::MatrixXf axes;    ///< (n_planes + 1, 3 * n_nodes), row 0 the mean, 0..1
  /// Mean square, over the weighted nodes and channels, of the planes' error.
  double dropped = 0.0;
};

/// @param nodes    (n_nodes, n_lights): values at the nodes from those at the lights
/// @param weights  (n_nodes), sum 1: weight of an error at a node
[[nodiscard]] LightAxes find_light_axes(const Eigen::MatrixXd& nodes,
                                        const Eigen::VectorXd& weights,
                                        const LightSample& sample, int n_planes);

}  // namespace haarlight::relight
