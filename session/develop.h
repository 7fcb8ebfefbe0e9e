#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

#include "core/image_io.h"
#include "core/progress.h"
#include "session/demosaic.h"
#include "session/demultiplex.h"
#include "session/light_stack.h"
#include "session/session.h"

/// @file
/// From raw frames to the light stack. Its own target, haarlight::develop (it uses oneTBB,
/// which the daemon does not link).

namespace haarlight {

struct DevelopOptions {
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  Demosaic demosaic = Demosaic::bilinear;
  bool keep_bayer = false;  ///< the same as Demosaic::none
  /// What stands in for a curve that nobody knows (Transfer::unknown); empty: refused.
  std::optional<Transfer> unknown_as{};
  bool use_cache = true;  ///< false: make it again even if the cached one fits
  /// Empty: SESSION/cache. Name a folder for a read-only archive.
  std::filesystem::path cache_folder{};
  ProgressStyle progress = ProgressStyle::none;
  /// For bins, target and partial haar captures: how a shot's light is shared out. Empty: an
  /// error for these, unless share_evenly.
  PlatePixels plate{};
  bool share_evenly = false;
};

/// Black and dark -> linear -> exposure, gain, drive and power -> hot pixels -> flat -> merge
/// of exposures, demultiplexing -> demosaic, for every light of a session; returns the stack,
/// made once and then cached in SESSION/cache/ under a key of everything it depends on. Out of
/// core: bands are sized to the memory budget.
///
/// Values: T = ((DN - black) / (white - black)) / (exposure in s * 10^(gain/20) * level/65535 *
/// relative power); an exposure of 0 (an import) counts as 1 s. Two sessions of one rig are
/// thus in the same units whatever their exposures.
/// @throws Error  samples through an unknown curve (a camera's YUYV) unless `unknown_as` names
///                one; a light without a frame, a frame that does not fit, NaN (by name), disk
///                full
[[nodiscard]] LightStack develop(const Session& session, const DevelopOptions& options = {});

}  // namespace haarlight
