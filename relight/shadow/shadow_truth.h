// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include "haarlight/core/image.h"
#include "relight/shadow/reproject.h"

/// @file
/// The ray-traced ground truth of a reprojected shadow, for known objects, and the error
/// against it.

namespace haarlight::relight {

/// Removes the triangles that lie in the shadow plane: a scene's ground is not part of the
/// object.
void remove_plane_triangles(render::Scene& scene, const PlaneFrame& frame);

/// The receivers lit with object and scene both casting shadows, the object itself invisible.
/// Lambertian part, RGB (h, w, 3); stratified samples at partly hidden lights.
[[nodiscard]] Image<float> trace_shadow(const render::Scene& receivers,
                                        const render::Scene& object, const CameraModel& camera,
                                        std::span<const render::SquareLight> lights,
                                        std::span<const Eigen::Vector3d> weights,
                                        int n_subpixels,
                                        ProgressStyle progress = ProgressStyle::none);

/// What is wrong is stated as fractions of the shadow: ||picture - truth||_1 / ||unshadowed -
/// truth||_1. Known is a lit value whose bounds differ by at most a hundredth of it.
struct ShadowError {
  double wrong_fraction = 0.0;
  double known_wrong_fraction = 0.0;
  double known_relative_l2 = 0.0;
  double known_fraction = 0.0;  ///< of the values that are lit without the object
  /// Where the result has a spread: of the values in shadow (below 98 % of the unshadowed one,
  /// here or in the truth), without those that were measured and are all dark.
  struct Spread {
    double holding_fraction = 0.0;  ///< those that differ from the truth by no more
    double median = 0.0;            ///< of the spreads, relative to the unshadowed value
    double mean_error = 0.0;        ///< of these values, in the same unit
    double rms_error = 0.0;
  };
  std::optional<Spread> spread;
};

/// @param truth (h, w, 3), as the result's pictures
[[nodiscard]] ShadowError compare_shadow(const ReprojectResult& result,
                                         const Image<float>& truth);

}  // namespace haarlight::relight
