// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/basis/compress.h"

/// @file
/// What all ways to a basis file share: the figures of docs/numerics/relight.md, "The coder".

namespace haarlight {

inline constexpr int kTile = 32;
/// Pixels below 1 % of the rms norm are judged against that.
inline constexpr double kDarkFloor = 0.01;
/// Plate: rms that vectors and polynomials may miss, each as a share of the target.
inline constexpr double kPlateShare = 0.25;
/// Gain step, as a share of the allowed rms error a pixel.
inline constexpr double kGainStep = 0.125;

/// The header before anything was looked at. @throws Error  as compress_stack()
[[nodiscard]] BasisHeader first_header(const CompressSource& source,
                                       const CompressOptions& options);

}  // namespace haarlight
