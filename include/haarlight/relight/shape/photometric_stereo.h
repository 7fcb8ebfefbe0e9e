// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/lambert_fit.h"
#include "haarlight/relight/shape/pixel_samples.h"

/// @file
/// Normals and albedo of a picture from its light stack, pixel by pixel [Woodham80]. Far: one
/// set of light directions for all pixels. Near (Huang et al., eqs. 4, 5): each pixel's own
/// directions, on brightness corrected for distance and lobe. A tile of the stack is in memory
/// at a time; masked pixels are neither read nor computed.

namespace haarlight::relight {

struct StereoOptions {
  LambertOptions fit{};
  /// (n_lights) or (channels, n_lights): a value at or above it is clipped; empty: none is.
  std::vector<float> saturation{};
  /// Standard errors of the stack's values: -1 marks a clipped value. May be null.
  const StackSource* errors = nullptr;
  /// Near lights: the view along which a point may be misplaced. With it and fit.has_sigma, the
  /// normals' standard errors include the points' inconsistency with the fall-off. May be null.
  const PixelPoints* view = nullptr;
  /// Which lights count; empty: all.
  std::vector<int> use{};
  ProgressStyle progress = ProgressStyle::none;
};

struct SurfaceEstimate {
  Image<float> normal;  ///< (height, width, 3) unit, in the lights' frame; 0 unless good
  Image<float> albedo;  ///< (height, width, channels): value under light that faces the surface
  Image<float> error;   ///< (height, width): rms residual over albedo
  Image<std::uint16_t> n_used;  ///< (height, width): lights in use
  Image<std::uint8_t> state;    ///< (height, width): PixelState
  /// (height, width): LambertFit::sigma_deg; 0 unless good. Empty if not requested.
  Image<float> sigma_deg{};

  [[nodiscard]] std::int64_t n_in(PixelState state) const;
  /// (height, width): 1 where good.
  [[nodiscard]] Image<std::uint8_t> is_good() const;
};

/// @throws Error  fewer than three lights, lights in one plane with the object (naming the
///                direction that they leave unknown), mismatched counts
/// @param points  (height, width, 3) in the lights' frame; near lights only, else may be empty
/// @param mask    (height, width): 0 is left out; empty: all pixels
[[nodiscard]] SurfaceEstimate photometric_stereo(const StackSource& stack,
                                                 const StereoLights& lights,
                                                 ImageView<const float> points,
                                                 ImageView<const std::uint8_t> mask,
                                                 const StereoOptions& options = {});

/// Directions to the lights from the middle of the points.
[[nodiscard]] std::vector<Eigen::Vector3d> middle_directions(const StereoLights& lights,
                                                             ImageView<const float> points);

/// The points of the reference plane that the pixels see, (height, width, 3).
[[nodiscard]] Image<float> plane_points(const PixelPoints& pixels, int width, int height);

}  // namespace haarlight::relight
