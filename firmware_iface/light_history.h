// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "haarlight/firmware_iface/light_array.h"

/// @file
/// What the light did and when: the input that a simulated camera integrates.

namespace haarlight::firmware_iface {

/// From `t_ns` on this is lit. Times are CLOCK_MONOTONIC nanoseconds of the change itself;
/// rise, fall and latch delays of a real LED are left to the camera model.
struct LightTransition {
  std::int64_t t_ns = 0;
  std::uint32_t tag = 0;  ///< 0 = dark by all_off, lease, fault or start
  /// Lit elements in ascending order, levels above 0; never null. Shared, never changed.
  std::shared_ptr<const std::vector<ElementLevel>> pattern;

  /// 0 when the element is off. O(log n).
  [[nodiscard]] std::uint16_t level(int element) const;
};

struct LightHistory {
  /// The state in force at the requested start, then every later change, in order of time.
  std::vector<LightTransition> states;
  /// False when the start is older than the history kept: the first state is then a later one.
  bool is_complete = true;
};

/// Seconds at full drive of one element between two times.
[[nodiscard]] double on_seconds(const LightHistory& history, int element, std::int64_t t0_ns,
                                std::int64_t t1_ns);

/// Keeps the last `capacity` transitions. One thread.
class TransitionLog {
 public:
  explicit TransitionLog(std::size_t capacity);
  void add(LightTransition transition);
  /// The state at t0 and each change in (t0, t1].
  [[nodiscard]] LightHistory between(std::int64_t t0_ns, std::int64_t t1_ns) const;
  [[nodiscard]] bool is_empty() const { return kept_.empty(); }
  /// Of a log that is not empty.
  [[nodiscard]] const LightTransition& latest() const { return kept_.back(); }

 private:
  std::size_t capacity_;
  bool is_truncated_ = false;
  std::deque<LightTransition> kept_;
};

}  // namespace haarlight::firmware_iface
