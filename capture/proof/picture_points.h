// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "capture/proof/light_predictor.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/session.h"

/// @file
/// The samples for the proof by light: 64 blocks of a picture, their noise, and which shots of
/// a plan should show the same. Definitions: docs/numerics/light-proof.md, "Samples".

namespace haarlight::capture {

using PointMask = Eigen::Array<bool, kProofPoints, 1>;

/// Means of small blocks in the middle of the 8 x 8 cells of a picture, at unit exposure.
struct PointSamples {
  PointValues mean = PointValues::Zero();          ///< counts per microsecond at 0 dB, less
                                                   ///< dark
  PointValues noise = PointValues::Zero();         ///< its variance: photon, read, rounding
  PointMask is_good = PointMask::Constant(false);  ///< no clipped pixel
};
/// @param dark_dn  per point
[[nodiscard]] PointSamples sample_points(ImageView<const std::uint16_t> active,
                                         const session::FrameForm& form,
                                         const SensorNoise& noise, const PointValues& dark_dn,
                                         double exposure_us, double gain_db);
/// The same from known means, at unit exposure.
[[nodiscard]] PointSamples samples_of(const PointValues& mean, const PointMask& is_good,
                                      const session::FrameForm& form, const SensorNoise& noise,
                                      double exposure_us, double gain_db);
/// The blocks' means in counts.
[[nodiscard]] PointValues block_means(ImageView<const std::uint16_t> active);

/// Marks a missing value in evidence.picture_points. (Means less dark may be negative, by
/// noise.)
inline constexpr double kClippedPoint = -1e9;

/// Relative error of a block not explained by noise.
inline constexpr double kPointModelTol = 3e-3;
/// Chi square from which a picture is not dark: 50 sigma.
inline constexpr double kLitSquare = 2500.0;
/// Between the starts of two exposures: the lights were off in between.
inline constexpr std::int64_t kDarkPauseNs = 1'000'000'000;

/// The square below which this fraction of the points' z^2 lies, relative to that of a normal
/// z: 1 for noise alone, 0 without points.
/// @param is_everywhere  nine of ten points instead of half of them
[[nodiscard]] double robust_square(const PointValues& z2, const PointMask& counts,
                                   bool is_everywhere = false);

/// Which shots of a plan show the same lights at the same levels: each shot's number, in the
/// order of first appearance; -1: none lit.
[[nodiscard]] std::vector<int> same_lights(const std::vector<session::Shot>& shots);

}  // namespace haarlight::capture
