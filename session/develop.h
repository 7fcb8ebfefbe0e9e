#pragma once

#include <cstdint>

#include "core/progress.h"
#include "session/light_stack.h"
#include "session/session.h"

/// @file
/// From raw frames to the light stack. Its own target, haarlight::develop (it uses oneTBB,
/// which the daemon does not link).

namespace haarlight {

/// How a Bayer mosaic becomes three channels.
enum class Demosaic {
  bilinear,    ///< mean of the nearest samples of a colour: exact where the picture is linear
  edge_aware,  ///< green along the smaller gradient, then colour differences [Hamilton97]
  none,        ///< leave the mosaic as one channel
};

struct DevelopOptions {
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  Demosaic demosaic = Demosaic::bilinear;
  bool keep_bayer = false;  ///< the same as Demosaic::none
  bool use_cache = true;    ///< false: make it again even if the cached one fits
  ProgressStyle progress = ProgressStyle::none;
};

/// Black and dark -> linear -> exposure, gain, drive and power -> hot pixels -> flat -> merge
/// of exposures, demultiplexing -> demosaic, for every light of a session; returns the stack,
/// made once and then cached in SESSION/cache/ under a key of everything it depends on. Out of
/// core: bands are sized to the memory budget.
///
/// Values: T = ((DN - black) / (white - black)) / (exposure in s * 10^(gain/20) * level/65535 *
/// relative power); an exposure of 0 (an import) counts as 1 s. Two sessions of one rig are
/// thus in the same units whatever their exposures.
/// @throws Error  a light without a frame, a frame that does not fit, NaN (by name), disk full
[[nodiscard]] LightStack develop(const Session& session, const DevelopOptions& options = {});

}  // namespace haarlight
