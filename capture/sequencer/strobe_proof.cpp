// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/strobe_proof.h"

#include <algorithm>
#include <optional>

namespace haarlight::capture {

namespace {

constexpr std::int64_t kShortestGuardNs = 100'000;
constexpr std::int64_t kLongestGuardNs = 1'000'000;

/// The readings entirely within [begin, end]: their counter, when there is one and they agree.
struct Span {
  bool has_reading = false;
  bool is_constant = true;
  std::uint32_t counter = 0;
  std::uint32_t tag = 0;
  std::int64_t t_first_ack_ns = 0;
};

Span readings_in(const std::deque<StepReading>& readings, std::int64_t begin_ns,
                 std::int64_t end_ns) {
  Span span;
  auto it = std::partition_point(
      readings.begin(), readings.end(),
      [begin_ns](const StepReading& reading) { return reading.t_request_ns < begin_ns; });
  for (; it != readings.end() && it->t_ack_ns <= end_ns; ++it) {
    span.is_constant = span.is_constant && (!span.has_reading || span.counter == it->counter);
    span.t_first_ack_ns = span.has_reading ? span.t_first_ack_ns : it->t_ack_ns;
    span.has_reading = true;
    span.counter = it->counter;
    span.tag = it->tag;
  }
  return span;
}

}  // namespace

std::int64_t strobe_guard_ns(std::int64_t period_ns) noexcept {
  return std::clamp(period_ns / 10, kShortestGuardNs, kLongestGuardNs);
}

StrobeProof prove_by_strobe(const std::deque<StepReading>& readings,
                            const session::ExposureWindow& window,
                            const StrobeTiming& timing) noexcept {
  const std::int64_t g = timing.guard_ns;
  const std::int64_t period = timing.period_ns;
  const std::int64_t strobe_ns = window.end_ns;  // of this frame, n
  const std::int64_t before_ns = strobe_ns - period;
  // Readings in frame n + i.
  const auto in_frame = [&](int i) {
    return readings_in(readings, before_ns + i * period + g, strobe_ns + i * period - g);
  };
  StrobeProof proof;
  const std::int64_t last_ns = before_ns + timing.every * period + g;
  if (readings.empty() || readings.back().t_request_ns < last_ns) {
    return proof;
  }
  proof.verdict = StrobeVerdict::unproven;
  const Span during = in_frame(0);
  const Span after = in_frame(1);
  const Span last = timing.every == 1 ? after : in_frame(timing.every);
  const auto is_at = [](const Span& span, std::uint32_t counter) {
    return span.has_reading && span.is_constant && span.counter == counter;
  };
  if (!is_at(during, during.counter) || !is_at(after, during.counter + 1) ||
      !is_at(last, during.counter + 1)) {
    return proof;
  }
  // Before the exposure, in the first frame of its step.
  const std::int64_t lit_ns = strobe_ns - timing.every * period;
  const std::int64_t lit_end_ns =
      std::min(window.start_ns - timing.settle_ns, lit_ns + period - g);
  const Span lit = readings_in(readings, lit_ns + g, lit_end_ns);
  const bool has_room = lit_end_ns - lit_ns - g >= period / 2;
  if (is_at(lit, during.counter)) {
    proof.t_shown_ns = lit.t_first_ack_ns;
  } else if (lit.has_reading || has_room ||
             !is_at(in_frame(-timing.every), during.counter - 1) ||
             !is_at(in_frame(1 - timing.every), during.counter)) {
    return proof;
  }
  proof.t_stable_ns = lit_ns + timing.settle_ns;
  if (proof.t_stable_ns > window.start_ns) {
    return proof;
  }
  proof.verdict = StrobeVerdict::proven;
  proof.counter = during.counter;
  proof.tag = during.tag;
  return proof;
}

}  // namespace haarlight::capture
