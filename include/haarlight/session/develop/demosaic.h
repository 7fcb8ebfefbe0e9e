// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/image.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/develop/develop_options.h"

/// @file
/// Bayer mosaic to three channels, linear in and out. Error on a known picture:
/// docs/reference/session-format.md, "Demosaic". Pure.

namespace haarlight::session {

/// Rows above and below that a row's result depends on; even, so that bands keep the phase.
inline constexpr int kDemosaicMargin = 4;

/// The colour of a mosaic's sample: 0 red, 1 green, 2 blue.
[[nodiscard]] int bayer_colour(BayerPattern pattern, int y, int x) noexcept;

/// Measured samples are kept unchanged; borders are mirrored about the outermost sample, which
/// keeps the phase.
/// @param mosaic   (h, w, 1), row 0 of the pattern's phase 0; at least 2 x 2
/// @param method   not none
/// @return         (h, w, 3)
[[nodiscard]] Image<float> demosaic(ImageView<const float> mosaic, BayerPattern pattern,
                                    Demosaic method);

}  // namespace haarlight::session
