// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include <gtest/gtest.h>

#include "capture/sequencer/frame_rhythm.h"
#include "tests/extremes.h"

namespace haarlight::capture {
namespace {

using extremes::both;
using extremes::bounded;
using extremes::Cell;
using extremes::stated;
using Position = FrameRhythm::Position;

EXTREMES_OF(rhythm, "capture/sequencer",
            "the camera's rhythm: period and scatter of timestamps")

constexpr std::int64_t kPeriod = 8'333'333;

/// Exact timestamps; how many of them are found on the rhythm after it is learnt.
struct Run {
  int n_on = 0;
  double period_ns = 0.0;
  double sigma_ns = 0.0;
};
Run run(std::int64_t start, std::int64_t period, std::uint64_t step = 1, int n = 40) {
  FrameRhythm rhythm;
  Run found;
  for (int i = 0; i < n; ++i) {
    const auto k = static_cast<std::uint64_t>(i) + 1;
    const FrameRhythm::Verdict verdict =
        rhythm.classify(k * step, start + static_cast<std::int64_t>(k * step) * period, 100.0);
    found.n_on += verdict.position == Position::on ? 1 : 0;
    EXPECT_TRUE(i < 8 || verdict.position == Position::on) << i;
  }
  found.period_ns = rhythm.period_ns();
  found.sigma_ns = rhythm.sigma_ns();
  return found;
}

Cell period_within(const Run& found, std::int64_t period, const std::string& what) {
  return bounded(std::abs(found.period_ns / static_cast<double>(period) - 1.0), 1e-9,
                 what + ": relative error of the period", "timestamps of whole ns, double");
}

NO_EXTREME(rhythm, dark, "timestamps alone, learnt in the dark")
EXTREME(rhythm, one) {
  FrameRhythm rhythm;
  EXPECT_EQ(rhythm.classify(1, 5'000'000'000, 100.0).position, Position::learning);
  EXPECT_FALSE(rhythm.is_known());
  return stated("one frame: learning");
}
EXTREME(rhythm, largest) {
  const auto start = std::int64_t{1} << 62;  // 146 years of uptime
  return period_within(run(start, kPeriod), kPeriod, "timestamps of 2^62 ns");
}
NO_EXTREME(rhythm, odd_size, "frame by frame")
EXTREME(rhythm, scale) {
  const Run fast = run(5'000'000'000, 10'000);
  EXPECT_EQ(fast.n_on, 32);
  return both(period_within(fast, 10'000, "100 000 frames a second"),
              period_within(run(5'000'000'000, 3'600'000'000'000), 3'600'000'000'000,
                            "one frame an hour"));
}
NO_EXTREME(rhythm, subnormal, "whole nanoseconds")
NO_EXTREME(rhythm, not_finite, "whole nanoseconds")
EXTREME(rhythm, degenerate) {
  // A driver that timestamps every frame alike.
  FrameRhythm rhythm;
  for (std::uint64_t k = 1; k <= 40; ++k) {
    (void)rhythm.classify(k, 5'000'000'000, 100.0);
  }
  EXPECT_FALSE(rhythm.period_ns() > 0.0);
  EXPECT_TRUE(std::isfinite(rhythm.period_ns()) && std::isfinite(rhythm.sigma_ns()));
  return stated("the same timestamp on every frame: no period is learnt");
}
NO_EXTREME(rhythm, grazing, "it knows no geometry")
EXTREME(rhythm, far_near) {
  FrameRhythm rhythm;
  std::int64_t t = 5'000'000'000;
  std::uint64_t k = 0;
  for (; k < 40; ++k, t += kPeriod) {
    (void)rhythm.classify(k + 1, t, 100.0);
  }
  constexpr std::uint64_t kLost = 1'000'000;  // two hours of frames, counted
  const FrameRhythm::Verdict verdict =
      rhythm.classify(k + 1 + kLost, t + static_cast<std::int64_t>(kLost) * kPeriod, 100.0);
  EXPECT_EQ(verdict.position, Position::on);
  return bounded(static_cast<double>(std::abs(verdict.off_ns)), 1e4,
                 "after 1e6 lost frames: distance from the rhythm, ns",
                 "1e-9 of the period for each");
}
EXTREME(rhythm, duplicate) {
  const Run found = run(5'000'000'000, kPeriod);
  EXPECT_EQ(found.n_on, 32);
  return bounded(found.sigma_ns, 1.0, "no scatter at all: sigma, ns", "whole ns");
}
NO_EXTREME(rhythm, clipped, "no samples")

}  // namespace
}  // namespace haarlight::capture
