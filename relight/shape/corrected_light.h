// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/relight/light/near_light.h"

/// @file
/// Pictures under near lights as they would be under far ones: each light's fall-off over the
/// picture, and the pictures without it. Source: Huang et al., eqs. 2 and 4, Figure 5. Pixels
/// are taken to lie on the reference plane; a surface h above it stays brighter by about 2 h /
/// (light's distance).

namespace haarlight::relight {

/// Which part of a light's fall-off is removed.
enum class FallOff {
  /// Distance and lobe, cos^mu / |l - p|^2: shading keeps each pixel's own light direction.
  distance,
  /// The whole stencil of the reference plane, n.(l - p) cos^mu / |l - p|^3: a flat target
  /// becomes uniform, as under a far light.
  plane,
};
inline constexpr auto kFallOffWords = std::to_array<std::string_view>({"distance", "plane"});
constexpr std::span<const std::string_view> words_of(FallOff) { return kFallOffWords; }

/// Thread-safe.
class LightCorrection {
 public:
  /// @param plane_normal  unit, of the reference plane, to the camera's side
  /// @throws Error  no light, or none that reaches the picture's middle
  LightCorrection(std::vector<NearLight> lights, PixelPoints points, int width, int height,
                  Eigen::Vector3d plane_normal, FallOff kind);

  [[nodiscard]] int n_lights() const noexcept { return static_cast<int>(lights_.size()); }
  /// The light's attenuation relative to the picture's middle, (height, width, 1): 1 there, 0
  /// behind the light; for a light that does not reach the middle, relative to its maximum.
  [[nodiscard]] Image<float> attenuation(int light) const;
  /// The picture divided by attenuation and power, times one factor for all lights that
  /// preserves the median light's brightness at the middle. 0 where the light does not reach.
  [[nodiscard]] Image<float> corrected(ImageView<const float> picture, int light) const;

 private:
  [[nodiscard]] double stencil(int light, double x, double y) const;

  std::vector<NearLight> lights_;
  PixelPoints points_;
  int width_;
  int height_;
  Eigen::Vector3d plane_normal_;
  FallOff kind_;
  double common_ = 1.0;  ///< median over the lights of power * stencil at the middle
};

}  // namespace haarlight::relight
