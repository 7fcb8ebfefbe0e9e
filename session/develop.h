#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "core/image_io.h"
#include "core/progress.h"
#include "session/demosaic.h"
#include "session/demultiplex.h"
#include "session/light_stack.h"
#include "session/radiometry.h"
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
  RadiometryOptions radiometry{};
  /// Make a second stack of the values' standard errors; -1 where every exposure (of a shot
  /// that the light needs) is clipped. Noise alone: not what a plate shares out wrongly.
  bool has_standard_error = false;
};

/// A light stack and what is known of it.
struct Developed {
  LightStack stack;
  std::optional<LightStack> standard_error;  ///< same shape; when asked for
  /// What each step did, as JSON (docs/session-format.md); beside the stack as stack-KEY.json.
  std::string record;
  std::uint64_t n_saturated = 0;  ///< values clipped in every exposure: lower bounds
  double moved_share = 0.0;       ///< of compared values whose exposures contradict each other
};

/// Linear steps above black -> dark -> exposure, gain, drift, drive and power -> flat -> merge
/// of exposures -> bad pixels -> demultiplexing -> demosaic, for every light of a session. Made
/// once and then cached in SESSION/cache/ under a key of everything it depends on. Out of core:
/// bands are sized to the memory budget.
///
/// Values: T = ((DN - black) / (white - black)) / (exposure in s * 10^(gain/20) * level/65535 *
/// relative power); an exposure of 0 (an import) counts as 1 s. Two sessions of one rig are
/// thus in the same units whatever their exposures. A value clipped in every exposure is the
/// greatest lower bound: counted in the record, -1 in the standard error.
/// @throws Error  samples through an unknown curve (a camera's YUYV) unless `unknown_as` names
///                one; a light without a frame, a frame that does not fit, NaN (by name), drift
///                or exposures out of bounds, no noise known for a standard error, disk full
[[nodiscard]] Developed develop_all(const Session& session, const DevelopOptions& options = {});
/// The stack alone.
[[nodiscard]] LightStack develop(const Session& session, const DevelopOptions& options = {});

}  // namespace haarlight
