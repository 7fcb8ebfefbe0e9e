// SPDX-License-Identifier: Apache-2.0
#include "session/clean_rule.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace haarlight::session {

namespace {

constexpr double kNsPerUs = 1e3;
constexpr double kMaxDurationUs = 9.0e15;  // 285 years: any larger number saturates

std::int64_t whole_ns(double us) {
  return std::llround(std::clamp(us, -kMaxDurationUs, kMaxDurationUs) * kNsPerUs);
}

std::int64_t add_saturating(std::int64_t a, std::int64_t b) {
  std::int64_t sum = 0;
  if (__builtin_add_overflow(a, b, &sum)) {
    return a < 0 ? std::numeric_limits<std::int64_t>::min()
                 : std::numeric_limits<std::int64_t>::max();
  }
  return sum;
}

double difference_us(std::int64_t later_ns, std::int64_t earlier_ns) {
  std::int64_t difference = 0;
  if (__builtin_sub_overflow(later_ns, earlier_ns, &difference)) {
    return (static_cast<double>(later_ns) - static_cast<double>(earlier_ns)) / kNsPerUs;
  }
  return static_cast<double>(difference) / kNsPerUs;
}

}  // namespace

ExposureWindow exposure_window(const ExposureTiming& timing) noexcept {
  const std::int64_t exposure = whole_ns(timing.exposure_us);
  std::int64_t start = timing.timestamp_ns;
  switch (timing.meaning) {
    case TimestampMeaning::start_exposure:
      break;
    case TimestampMeaning::start_readout:
      start = add_saturating(start, -exposure);
      break;
    case TimestampMeaning::end_frame:
      start = add_saturating(add_saturating(start, -whole_ns(timing.read_us)), -exposure);
      break;
  }
  return {start, add_saturating(add_saturating(start, exposure), whole_ns(timing.skew_us))};
}

CleanVerdict assess_clean(const ExposureWindow& window, std::int64_t t_stable_ns,
                          std::int64_t t_next_change_ns) noexcept {
  CleanVerdict verdict;
  verdict.is_clean = window.start_ns >= t_stable_ns && window.end_ns <= t_next_change_ns;
  verdict.margin_us = std::min(difference_us(window.start_ns, t_stable_ns),
                               difference_us(t_next_change_ns, window.end_ns));
  return verdict;
}

double camera_leads_margin_us(double exposure_us, double skew_us, double settle_us,
                              double guard_us, double period_us) noexcept {
  return period_us - (exposure_us + skew_us + settle_us + guard_us);
}

std::string find_evidence_problem(const FrameEvidence& e) {
  if (e.pixel_hash.empty()) {
    return "the evidence has no pixel hash";
  }
  if (e.kind == EvidenceKind::asserted) {
    return {};
  }
  if (e.tag != e.tag_echo) {
    return fmt::format("the controller echoed tag {}, not {}", e.tag_echo, e.tag);
  }
  constexpr std::uint32_t kDamaged = 3;  // FrameFlag kFrameError | kFrameShort
  if ((e.flags & kDamaged) != 0) {
    return fmt::format("the camera marked the frame as damaged (flags {:#x})", e.flags);
  }
  const ExposureWindow window = exposure_window(
      {e.timestamp_ns, e.timestamp_meaning, e.exposure_read_us, e.read_us, e.skew_us});
  if (window != ExposureWindow{e.t_exposure_start_ns, e.t_exposure_end_ns}) {
    return fmt::format(
        "the stored exposure {} .. {} ns does not follow from the timestamp, which gives {} .. "
        "{} "
        "ns",
        e.t_exposure_start_ns, e.t_exposure_end_ns, window.start_ns, window.end_ns);
  }
  if (e.sync == SyncMode::camera_leads) {
    if (e.step_before < 0 || e.step_after != e.step_before + 1) {
      return fmt::format("the step counter went from {} to {}, not one on", e.step_before,
                         e.step_after);
    }
    if (e.t_exposure_start_ns < e.t_stable_ns || e.t_exposure_end_ns > e.t_next_change_ns) {
      return fmt::format(
          "exposed {} .. {} ns, outside the time from its strobe's settling to the next "
          "strobe, "
          "{} .. {} ns",
          e.t_exposure_start_ns, e.t_exposure_end_ns, e.t_stable_ns, e.t_next_change_ns);
    }
    if (e.t_shown_ns && (*e.t_shown_ns < e.t_ack_ns || *e.t_shown_ns > e.t_exposure_start_ns)) {
      return fmt::format(
          "its step was read at {} ns, not between the arming's {} ns and the "
          "exposure's start at {} ns",
          *e.t_shown_ns, e.t_ack_ns, e.t_exposure_start_ns);
    }
    return e.margin_us >= 0.0
               ? std::string()
               : fmt::format("the light did not fit the frame period by {} us", -e.margin_us);
  }
  // Sessions from before the read-back's time was stored counted from the acknowledgement.
  const std::int64_t t_shown_ns = e.t_shown_ns.value_or(e.t_ack_ns);
  if (e.t_ack_ns < e.t_command_ns || t_shown_ns < e.t_ack_ns || e.t_stable_ns < t_shown_ns) {
    return fmt::format(
        "command {}, acknowledgement {}, read back {}, stable {} ns are out of order",
        e.t_command_ns, e.t_ack_ns, t_shown_ns, e.t_stable_ns);
  }
  const CleanVerdict verdict = assess_clean(window, e.t_stable_ns, e.t_next_change_ns);
  if (!verdict.is_clean) {
    return fmt::format("exposed {:.1f} us outside the time its light was stable",
                       -verdict.margin_us);
  }
  return {};
}

}  // namespace haarlight::session
