// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"

/// @file
/// The steps from one pixel's height to its neighbour's implied by the normals. Parallel
/// projection: heights in mm towards the camera. A camera: the logarithm of the distance from
/// the camera, ln D, since n.(D r)' = 0 gives (ln D)' = -n.r'/n.r for rays r; exact for planes
/// seen in perspective.

namespace haarlight::relight {

/// Normals steeper than this are taken as this steep and counted: n.(to camera) at 88.9
/// degrees.
inline constexpr double kLeastFacing = 0.02;

struct SlopeField {
  Image<float> step_right;       ///< (height, width), to pixel (y, x + 1); 0: none
  Image<float> step_down;        ///< (height, width), to pixel (y + 1, x)
  Image<float> slope_right;      ///< (height, width), per pixel, at the pixel's own centre
  Image<float> slope_down;       ///< the same, downwards
  Image<std::uint8_t> is_known;  ///< (height, width)
  std::int64_t n_steep = 0;      ///< pixels whose normals were clamped
  [[nodiscard]] int height() const noexcept { return is_known.height(); }
  [[nodiscard]] int width() const noexcept { return is_known.width(); }
};

/// @param normals   (height, width, 3) unit, picture's frame: x right, y up, z to the camera
/// @param is_known  (height, width) 0: no normal there
/// Steps are the mean of both pixels' slopes: exact for quadratic surfaces, else O(pixel^2).
[[nodiscard]] SlopeField orthographic_slopes(ImageView<const float> normals,
                                             ImageView<const std::uint8_t> is_known,
                                             double mm_per_pixel);

/// @param normals  (height, width, 3) unit, world frame
/// Steps of ln D: the mean over the two pixels' tangent planes.
[[nodiscard]] SlopeField perspective_slopes(ImageView<const float> normals,
                                            ImageView<const std::uint8_t> is_known,
                                            const CameraModel& camera);

}  // namespace haarlight::relight
