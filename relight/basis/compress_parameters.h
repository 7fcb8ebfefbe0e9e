// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/relight/basis/compress.h"

/// @file
/// Parameters common to all ways to a basis file: the figures of docs/numerics/relight.md, "The
/// coder".

namespace haarlight::relight {

inline constexpr int kTile = 32;
/// For pixels below 1 % of the rms norm, errors are relative to that.
inline constexpr double kDarkFloor = 0.01;
/// Clean plate: rms error allowed to vectors and polynomials, each as a fraction of the target.
inline constexpr double kPlateFraction = 0.25;
/// Gain step, as a fraction of the allowed rms error per pixel.
inline constexpr double kGainStep = 0.125;

/// The header before any data is inspected. @throws Error  as compress_stack()
[[nodiscard]] BasisHeader first_header(const CompressSource& source,
                                       const CompressOptions& options);

}  // namespace haarlight::relight
