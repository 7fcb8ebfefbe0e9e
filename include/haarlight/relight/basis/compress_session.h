// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/plate/plate_source.h"
#include "haarlight/session/develop/develop_options.h"
#include "haarlight/session/session.h"

/// @file
/// A session to a basis file: develop, find the clean plate, compress. Also a rig's computed
/// clean plate.

namespace haarlight::relight {

/// The grid of each face, where the session's lights form rows and columns; else 0 x 0.
[[nodiscard]] HaarGrid haar_grid(const session::SessionInfo& info);

/// The clean plate by which develop distributes a shot's light, for sessions whose shots light
/// several lights at once and do not determine them all (bins, target, some wavelets); empty
/// for all others, and where the choice yields none.
/// @throws Error  a plate of another size or other lights
[[nodiscard]] session::PlatePixels sharing_plate(const session::Session& session,
                                                 const PlateChoice& choice);

/// ||noise|| / ||T|| of a session's stack, the light transport matrix T: from its values'
/// standard errors
/// (haarlight/session/develop/develop.h), in up to 16 rows spread over the picture. A value
/// that is clipped in every exposure is the same each time and has no noise (what it lacks is
/// covered by ClippedValues). Nothing if the camera's noise was not measured (the rig file has
/// none), or if the rows are black.
/// @throws Error  as develop() does
[[nodiscard]] std::optional<double> measure_noise(const session::Session& session,
                                                  const PlateChoice& choice,
                                                  const CompressOptions& options);

/// The error worth requesting for a noisy stack, as a multiple of its noise: where the
/// compressed stack comes closest to the noise-free light (docs/numerics/relight.md, "Noise").
inline constexpr double kNoiseTarget = 1.1;

/// options.relative_l2 = 0: as whole camera steps where that is bit-exact.
/// @throws Error  as develop() and compress_stack() do
[[nodiscard]] CompressSummary compress_session(const session::Session& session,
                                               const PlateChoice& plate,
                                               const std::filesystem::path& file,
                                               const CompressOptions& options);

/// The computed clean plate of a rig as a basis file of its own.
[[nodiscard]] CompressSummary compress_plate(const Rig& rig, const std::filesystem::path& file,
                                             const CompressOptions& options);

}  // namespace haarlight::relight
