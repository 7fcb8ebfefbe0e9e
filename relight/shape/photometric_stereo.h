#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "core/image.h"
#include "core/progress.h"
#include "relight/basis/stack_source.h"
#include "relight/light/near_light.h"
#include "relight/shape/lambert_fit.h"

/// @file
/// Normals and albedo of a picture from its light stack, pixel by pixel [Woodham80]. Far: one
/// set of light directions for all pixels. Near (Huang et al., eqs. 4, 5): each pixel's own
/// directions, on brightness freed of distance and lobe. A tile of the stack is in memory at a
/// time; masked pixels are neither read nor computed.

namespace haarlight {

/// The lights of a stack, in its order and in one frame.
struct StereoLights {
  bool are_near = false;
  std::vector<NearLight> near;              ///< (n_lights) where are_near
  std::vector<Eigen::Vector3d> directions;  ///< (n_lights) unit, to the light, else
  std::vector<Eigen::Vector3d> powers;      ///< far: (n_lights) R, G, B; empty: all 1
};

struct StereoOptions {
  LambertOptions fit{};
  /// (n_lights): a value at or above is clipped; empty: none is.
  std::vector<float> saturation{};
  /// Standard errors of the stack's values: -1 marks a clipped value. May be null.
  const StackSource* errors = nullptr;
  ProgressStyle progress = ProgressStyle::none;
};

struct SurfaceEstimate {
  Image<float> normal;  ///< (height, width, 3) unit, in the lights' frame; 0 unless good
  Image<float> albedo;  ///< (height, width, channels): value under light that faces the surface
  Image<float> error;   ///< (height, width): rms residual over albedo
  Image<std::uint16_t> n_used;  ///< (height, width): lights that count
  Image<std::uint8_t> state;    ///< (height, width): PixelState

  [[nodiscard]] std::int64_t n_in(PixelState state) const;
  /// (height, width): 1 where good.
  [[nodiscard]] Image<std::uint8_t> is_good() const;
};

/// @throws Error  fewer than three lights, lights in one plane with the object (naming the
///                direction that they leave unknown), counts that differ
/// @param points  (height, width, 3) in the lights' frame; near lights only, else may be empty
/// @param mask    (height, width): 0 is left out; empty: all pixels
[[nodiscard]] SurfaceEstimate photometric_stereo(const StackSource& stack,
                                                 const StereoLights& lights,
                                                 ImageView<const float> points,
                                                 ImageView<const std::uint8_t> mask,
                                                 const StereoOptions& options = {});

/// The points of the reference plane that the pixels see, (height, width, 3).
[[nodiscard]] Image<float> plane_points(const PixelPoints& pixels, int width, int height);

}  // namespace haarlight
