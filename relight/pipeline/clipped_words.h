// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "core/report.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"

/// @file
/// A command's message about values that were clipped in every exposure: they are lower bounds,
/// and no stated error covers what they lack. Empty if nothing was clipped.

namespace haarlight::relight {

/// For a whole basis file, as a line of its own.
[[nodiscard]] std::string clipped_words(const BasisHeader& header);
void report_clipped(const BasisHeader& header, Report& report);

/// Clipping in one picture.
struct PictureClipping {
  double fraction = 0.0;  ///< of the values under the lights in use
  /// Were the clipped values truly up to 1 + f times as bright, the picture's relative error is
  /// at most its bound + f * relative. Infinity where the bound is.
  double relative = 0.0;
};
[[nodiscard]] PictureClipping picture_clipping(const RelightBound& bound);
[[nodiscard]] std::string clipped_words(const BasisHeader& header,
                                        const PictureClipping& clipping);
void report_clipped(const BasisHeader& header, const PictureClipping& clipping, Report& report);

}  // namespace haarlight::relight
