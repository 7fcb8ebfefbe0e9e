// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/lambert_fit.h"

/// @file
/// One pixel's brightness under the lights in use, in the form the photometric model requires:
/// corrected for distance, lobe and power, with the direction to each light (Huang et al., eqs.
/// 4, 5).

namespace haarlight::relight {

/// The lights of a stack, in its order and in one frame.
struct StereoLights {
  bool are_near = false;
  std::vector<NearLight> near;              ///< (n_lights) where are_near
  std::vector<Eigen::Vector3d> directions;  ///< (n_lights) unit, to the light, else
  std::vector<Eigen::Vector3d> powers;      ///< far: (n_lights) R, G, B; empty: all 1
};

/// Unit directions to the lights, seen from `point`; for far lights independent of it.
[[nodiscard]] std::vector<Eigen::Vector3d> directions_from(const StereoLights& lights,
                                                           const Eigen::Vector3d& point);

/// Borrows the lights. One thread.
class PixelSamples {
 public:
  /// @param use         which lights, in this order; empty: all
  /// @param saturation  (n_lights) or (channels, n_lights), a value at or above is clipped; may
  ///                    be empty
  PixelSamples(const StackDims& dims, const StereoLights& lights, const std::vector<int>& use,
               std::span<const float> saturation = {});

  [[nodiscard]] int n() const noexcept { return static_cast<int>(use_.size()); }
  /// Sample j's light in the stack.
  [[nodiscard]] int light(int j) const { return use_[static_cast<std::size_t>(j)]; }
  /// Sets directions and the scales to unit irradiance for a surface at `point`.
  void aim(const Eigen::Vector3d& point);
  /// Loads a pixel's brightness, the mean of the channels.
  /// @param values  (channels, width, n_lights) of a tile of one row
  /// @param i       the pixel in it
  /// @param errors  as `values`, -1 marks a clipped one; may be empty
  void take(std::span<const float> values, int i, int width,
            std::span<const float> errors = {});
  /// Gives the fitter, cleared, the loaded samples that are neither void nor clipped, and the
  /// number of the clipped.
  void give(LambertFitter& fitter);

  /// Whether the loaded sample j only says "at least this".
  [[nodiscard]] bool is_clipped(int j) const { return clipped_[j] != 0; }
  /// Unit, to the light.
  [[nodiscard]] Eigen::Vector3d direction(int j) const { return {x_[j], y_[j], z_[j]}; }
  /// Brightness of the loaded pixel, times scale().
  [[nodiscard]] double value(int j) const { return value_[j]; }
  /// 0: the pixel lies behind the light, whose sample is void.
  [[nodiscard]] double scale(int j) const { return scale_[j]; }
  /// 1 / power.
  [[nodiscard]] double gain(int channel, int j) const { return gain_(j, channel); }
  /// The loaded value of one channel, as it was taken.
  [[nodiscard]] float raw(int channel, int j) const { return raw_(j, channel); }

 private:
  const StereoLights& lights_;
  std::vector<int> use_;
  int channels_;
  int n_lights_;
  bool are_lambertian_;    ///< near lights, all of mu 1
  Eigen::ArrayXXd gain_;   ///< (n, channels)
  Eigen::ArrayXXf limit_;  ///< likewise: clipped from there on; empty: none is
  Eigen::ArrayXXf raw_;    ///< likewise
  Eigen::ArrayX3d positions_, axes_;
  Eigen::ArrayXd x_, y_, z_, value_, scale_, lobe_;
  Eigen::Array<std::uint8_t, Eigen::Dynamic, 1> clipped_, left_out_;
};

}  // namespace haarlight::relight
