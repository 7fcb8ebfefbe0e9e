// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "firmware_iface/light_controller.h"

/// @file
/// What goes wrong in the virtual rig, and when. Written as TOML, see
/// docs/reference/simulator.md:
///
///     [frames]
///     late_share = 0.01       late_ms = 30.0
///     drop_share = 0.01       duplicate_share = 0.01
///     stale_share = 0.01      swap_share = 0.01      jitter_us = 50.0
///     [[bus]]
///     at_s = 2.0   for_s = 1.5   kind = "dead"        # or "slow" with delay_ms
///     [[restart]]
///     at_s = 5.0   off_ms = 300
///     [late_light]
///     share = 0.1   least_ms = 5.0   most_ms = 60.0   shows = "with_light"   # "at_once",
///     "in_order"

namespace haarlight::sim {

/// Fractions of all frames, drawn by (seed, sequence).
struct FrameFaults {
  double late_fraction = 0.0;  ///< arrives `late_ms` late, with a correct timestamp
  double late_ms = 30.0;
  double drop_fraction = 0.0;       ///< lost: a gap in the sequence
  double duplicate_fraction = 0.0;  ///< delivered twice, same sequence, timestamp and memory
  double stale_fraction = 0.0;      ///< new sequence and timestamp, the previous frame's pixels
  double swap_fraction = 0.0;       ///< delivered after its successor
  double jitter_us = 0.0;           ///< rms of the exposure's start, 3 sigma at most
};

/// The bus answers late, or not at all, for some time.
struct BusFault {
  double at_s = 0.0;
  double for_s = 0.0;
  bool is_dead = true;
  double delay_ms = 0.0;
};

struct ControllerRestart {
  double at_s = 0.0;
  double off_ms = 300.0;
};

/// Seconds are counted from the first frame that the camera streams.
struct FaultScript {
  FrameFaults frames;
  std::vector<BusFault> bus;
  std::vector<ControllerRestart> restarts;
  firmware_iface::LateActing late_light;  ///< from the start; uses the rig's seed
};

/// @throws Error  every problem with file:line and a hint
[[nodiscard]] FaultScript read_fault_script(const std::filesystem::path& path);
[[nodiscard]] FaultScript parse_fault_script(const std::string& text, const std::string& name);

}  // namespace haarlight::sim
