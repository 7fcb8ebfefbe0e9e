// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/relight/shadow/plane_frame.h"

/// @file
/// Camera picture -> plane picture, by the calibrated camera with its distortion. The map is
/// computed once and used for every light's picture.

namespace haarlight::relight {

class PlaneSampler {
 public:
  /// Each plane pixel is the mean of n x n bilinear samples; n follows from the camera's pixel
  /// size on the plane (at most 8).
  /// @param shows_plane  (h, w, 1) of the camera picture: 1 where the camera sees the plane, 0
  ///                     where the object hides it. Empty: everywhere.
  PlaneSampler(const CameraModel& camera, const PlaneFrame& frame,
               ImageView<const std::uint8_t> shows_plane = {});

  /// @param picture  (h, w, c) of the camera
  /// @return         (frame.height, frame.width, c); 0 where unknown
  [[nodiscard]] Image<float> rectify(ImageView<const float> picture) const;

  /// (frame.height, frame.width, 1): 1 where every sample lies in the camera picture and on the
  /// plane, 0 where the plane picture is unknown.
  [[nodiscard]] const Image<std::uint8_t>& known() const noexcept { return known_; }

  /// Fraction of the plane picture that is known.
  [[nodiscard]] double known_fraction() const;

  /// Camera pixels across one plane pixel, at the plane's middle; 1 if that is not visible.
  [[nodiscard]] double pixels_per_texel() const noexcept { return pixels_per_texel_; }

  /// Samples per side for each plane pixel.
  [[nodiscard]] int n_samples() const noexcept { return n_samples_; }

 private:
  struct Tap {
    std::uint32_t pixel = 0;
    float weight = 0.0F;
  };
  void add_sample(double x, double y, float weight, std::vector<Tap>& taps) const;

  int camera_width_ = 0;
  int camera_height_ = 0;
  double pixels_per_texel_ = 1.0;
  int n_samples_ = 1;
  Image<std::uint8_t> known_;
  std::vector<std::uint32_t> first_tap_;  ///< (n_pixels + 1,)
  std::vector<Tap> taps_;
};

}  // namespace haarlight::relight
