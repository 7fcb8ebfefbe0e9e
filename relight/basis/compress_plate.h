// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>

#include "haarlight/relight/basis/compress.h"
#include "relight/basis/plate/plate.h"

/// @file
/// Compresses a computed clean plate without evaluating every pixel under every light. Sums
/// over all pixels are taken in the coordinates of the few vectors that span the plate
/// (smooth_plate.h); their own error is measured at drawn pixels on the decoded file and is
/// part of every stated error. Method, cost: docs/numerics/relight.md, "What a plate costs".

namespace haarlight::relight {

/// Writes the file that compress_stack() would, up to rounding, or nothing if the plate is not
/// smooth over its tiles or plate vectors alone do not achieve the requested error.
/// @param source  its stack and plate are `plate`
/// @param degree  of the tiles' series; 0: as smooth_degree() chooses. Too small a degree must
///                still give stated errors that hold (for tests)
/// @throws Error  as compress_stack()
[[nodiscard]] std::optional<CompressSummary> compress_smooth_plate(
    const ComputedPlate& plate, const CompressSource& source, const std::filesystem::path& file,
    const CompressOptions& options, int degree = 0);

}  // namespace haarlight::relight
