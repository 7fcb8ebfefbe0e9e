// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/relight/shadow/visibility.h"

/// @file
/// Whether the plane lies where the rig file says. Brightness falls off from light to light as
/// the lights' distances and angles do, whatever the albedo: at a wrong height T/B is not
/// constant over the lights (height_from_falloff). Sees nothing if B was itself captured on that
/// plane, and needs none of its geometry then.

namespace haarlight::relight {

/// Of the surface that a camera pixel shows, if most lights reach it unhindered: over the plane,
/// any albedo, up to an eighth of the lights' height.
/// @param values, plate, slopes  (n_lights), as height_from_falloff
[[nodiscard]] std::optional<SurfaceHeight> height_of_lit(std::span<const float> values,
                                                         std::span<const float> plate,
                                                         std::span<const double> slopes);

/// Where the surface lies that most of the pixels show, against the rig's plane.
struct PlaneOffset {
  double mm = 0.0;        ///< towards the lights, at the middle of the plane's picture
  double tilt_deg = 0.0;  ///< between the two
  double most_mm = 0.0;   ///< at the farthest corner of the picture, without sign
  double error_mm = 0.0;  ///< standard error of one pixel's height: of what all have in common
  std::size_t n_pixels = 0;
  /// More than three standard errors and a 500th of the lights' height.
  bool is_noticeable = false;
};

/// One pixel's height over the rig's plane.
struct PlanePoint {
  Eigen::Vector2d position =
      Eigen::Vector2d::Zero();  ///< mm along u and v from the picture's middle
  SurfaceHeight height;
};

/// A plane through the half of the points that are closest to one: least squares, from the
/// median height, until that half no longer changes. Right while more than half of them show the
/// plane; a flat object that fills more of the picture is taken for it.
/// @param lights_mm  mean height of the lights over the plane
[[nodiscard]] PlaneOffset plane_offset(std::vector<PlanePoint> points, const PlaneFrame& frame,
                                       double lights_mm);

}  // namespace haarlight::relight
