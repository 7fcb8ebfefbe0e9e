// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <limits>

#include <Eigen/Core>

#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/plane_frame.h"

/// @file
/// Eq. (5) in world coordinates, corner by corner, as the paper has it: what look_up() is held
/// to, which works in the picture's own coordinates.

namespace haarlight::shadow_scene {

/// Visibility of one light at a vertex by the rule. The window is never smaller than a pixel:
/// then it is bilinear interpolation.
/// @param object_height_fraction  h_o/H for the corrected rule; negative: unknown, W is used
inline relight::WindowMean window_visibility(const relight::PlaneFrame& frame,
                                             const relight::WindowSums& sums,
                                             const relight::LightWindow& window,
                                             relight::WindowRule rule,
                                             double object_height_fraction) {
  const Eigen::Vector2d c = frame.picture_of(window.centre);
  const auto interpolate = [&] {
    return sums.mean(c.x() - 0.5, c.x() + 0.5, c.y() - 0.5, c.y() + 0.5);
  };
  const bool is_below = window.status == relight::ProjectionStatus::below;
  const bool is_windowed = rule == relight::WindowRule::plain ||
                           (rule == relight::WindowRule::corrected && is_below);
  if (!is_windowed || !window.has_corners ||
      window.status == relight::ProjectionStatus::on_plane) {
    return interpolate();
  }
  double scale = 1.0;
  if (rule == relight::WindowRule::corrected && object_height_fraction > 0.0) {
    scale = relight::corrected_window_scale(window.ratio, object_height_fraction);
  }
  std::array<Eigen::Vector2d, 4> quad;
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (std::size_t i = 0; i < 4; ++i) {
    quad[i] = c + scale * (frame.picture_of(window.corners[i]) - c);
    low = low.cwiseMin(quad[i]);
    high = high.cwiseMax(quad[i]);
  }
  // A rectangle along the axes (a plane parallel to the lights) has a closed form.
  const double tolerance = 1e-9 * (high - low).sum();
  const bool is_upright = std::all_of(quad.begin(), quad.end(), [&](const Eigen::Vector2d& q) {
    return std::min(q.x() - low.x(), high.x() - q.x()) <= tolerance &&
           std::min(q.y() - low.y(), high.y() - q.y()) <= tolerance;
  });
  if (is_upright || (high - low).maxCoeff() <= 1.0) {
    // Never smaller than a pixel: the mean over one pixel's square is bilinear interpolation.
    const Eigen::Vector2d half = (0.5 * (high - low)).cwiseMax(0.5);
    const Eigen::Vector2d middle = 0.5 * (low + high);
    return sums.mean(middle.x() - half.x(), middle.x() + half.x(), middle.y() - half.y(),
                     middle.y() + half.y());
  }
  return sums.mean(quad);
}

}  // namespace haarlight::shadow_scene
