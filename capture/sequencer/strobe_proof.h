// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "session/clean_rule.h"

/// @file
/// Camera leads: which entry of the pattern table a frame saw, from readings of the
/// controller's step counter. The strobe at the end of frame n's exposure steps the table, so
/// the counter is constant while frame n is exposed and one more in the frame after. Pure.
///
/// Frame n saw the table's entry k - 1 and nothing else when
///
///   (a) the counter was k before its exposure began and the light had settled by then: a
///       reading k between strobe n - 1 and (start - settle). Where that time is shorter than
///       half a frame a reading cannot be expected in it: then k - 1 in frame n - 1 and k in
///       frame n, which trusts the controller to step at the strobe's edge;
///   (b) it was k in frame n, and the tag read with it is that entry's;
///   (c) it was k + 1 in frame n + 1.
///
/// So a controller that steps late, its counter with its light, is detected where there is time
/// for a reading. One step lies between (a) and (c), and the strobe at the end of frame n is
/// the one edge that was due there. What this cannot detect: a strobe that is lost *and* a
/// spurious edge instead of it within the same frame (d frames), and two late steps in a row,
/// which amount to the same. A single lost, spurious or late edge voids its frame.
///
/// A table that steps at every d-th strobe (d >= 2) lights the last of d frames cleanly. There
/// (a) requires k in frame n - d + 1 already, before (start - settle); where the exposure
/// begins so early that a reading cannot be expected, k - 1 in frame n - d and k in n - d + 1.
/// And (c) holds until frame n + d, as a spurious edge would shift the phase of the steps.

namespace haarlight::capture {

/// The controller's status at some instant between the two times.
struct StepReading {
  std::int64_t t_request_ns = 0;
  std::int64_t t_ack_ns = 0;
  std::uint32_t counter = 0;
  std::uint32_t tag = 0;
};

struct StrobeTiming {
  std::int64_t period_ns = 0;  ///< from frame to frame
  std::int64_t settle_ns = 0;  ///< from the strobe until the light has certainly settled
  std::int64_t guard_ns = 0;   ///< readings closer to a strobe than this are ignored
  int every = 1;               ///< strobes per step
};

/// A tenth of the frame period, 0.1 to 1 ms: jitter of timestamps, and the strobe's own delay.
[[nodiscard]] std::int64_t strobe_guard_ns(std::int64_t period_ns) noexcept;

enum class StrobeVerdict { wait, unproven, proven };

struct StrobeProof {
  StrobeVerdict verdict = StrobeVerdict::wait;
  std::uint32_t counter = 0;     ///< k
  std::uint32_t tag = 0;         ///< read during the frame
  std::int64_t t_stable_ns = 0;  ///< the strobe that lit it, plus settle
  /// The answer of the first reading k; nothing where (a) relies on the controller.
  std::optional<std::int64_t> t_shown_ns;
};

/// @param readings  in order of time
/// @return  wait: the frame after it was not read yet; decided once a reading is later than
///     that frame. Whether `now_ns` is so late that none can arrive any more is for the caller
///     to decide
[[nodiscard]] StrobeProof prove_by_strobe(const std::deque<StepReading>& readings,
                                          const session::ExposureWindow& window,
                                          const StrobeTiming& timing) noexcept;

}  // namespace haarlight::capture
