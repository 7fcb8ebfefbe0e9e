// SPDX-License-Identifier: Apache-2.0
#include "capture/sequencer/frame_rhythm.h"

#include <cstdlib>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "tests/drawn_seed.h"

namespace haarlight::capture {
namespace {

using Position = FrameRhythm::Position;

/// A stream of frames whose timestamps scatter.
struct Stream {
  double period_ns = 8'333'333.0;
  double sigma_ns = 0.0;
  std::uint64_t seed = 1;
  double exposure_us = 2000.0;
  std::uint64_t n = 0;
  double t_ns = 5e9;
  double error_ns = 0.0;  ///< of the newest timestamp

  /// The next frame after `lost` others.
  FrameRhythm::Verdict next(FrameRhythm& rhythm, double lie_ns = 0.0, std::uint64_t lost = 0) {
    n += 1 + lost;
    t_ns += period_ns * static_cast<double>(1 + lost);
    error_ns = sigma_ns * standard_normal(hash_key(seed, n)) + lie_ns;
    return rhythm.classify(n, static_cast<std::int64_t>(t_ns + error_ns), exposure_us);
  }
};

TEST(FrameRhythm, EightFramesTellThePeriodAndEveryLaterOneIsClassified) {
  Stream stream;
  FrameRhythm rhythm;
  for (int i = 0; i < 8; ++i) {
    EXPECT_EQ(stream.next(rhythm).position, Position::learning);
  }
  EXPECT_EQ(stream.next(rhythm).position, Position::on);
  EXPECT_NEAR(rhythm.period_ns(), stream.period_ns, 1.0);
  for (const double lie_us : {-1900.0, -100.0, 100.0, 1500.0, 1900.0}) {
    const FrameRhythm::Verdict verdict = stream.next(rhythm, lie_us * 1e3);
    EXPECT_EQ(verdict.position, Position::off) << lie_us;
    EXPECT_NEAR(static_cast<double>(verdict.off_ns), lie_us * 1e3, 10.0);
    EXPECT_EQ(stream.next(rhythm).position, Position::on)
        << "one false timestamp spoils no other";
  }
  EXPECT_EQ(stream.next(rhythm, 50e3).position, Position::on) << "within the guard";
}

TEST(FrameRhythm, LostFramesThatAreCountedChangeNothing) {
  Stream stream{.sigma_ns = 20e3};
  FrameRhythm rhythm;
  for (int i = 0; i < 40; ++i) {
    (void)stream.next(rhythm);
  }
  EXPECT_EQ(stream.next(rhythm, 0.0, 30).position, Position::on);
  EXPECT_EQ(stream.next(rhythm).position, Position::on);
}

TEST(FrameRhythm, AFrameLostWithoutBeingCountedCostsOneMore) {
  Stream stream;
  FrameRhythm rhythm;
  for (int i = 0; i < 40; ++i) {
    (void)stream.next(rhythm);
  }
  stream.t_ns += 2.0 * stream.period_ns;
  EXPECT_EQ(stream.next(rhythm).position, Position::off);
  EXPECT_EQ(stream.next(rhythm).position, Position::on);
}

TEST(FrameRhythm, AnotherExposureCostsOneFrameOrThreeWhereItMovesTheTimestamps) {
  for (const double moved_ns : {0.0, 3e6, 1.1e6}) {
    Stream stream{.sigma_ns = 20e3};
    FrameRhythm rhythm;
    for (int i = 0; i < 40; ++i) {
      (void)stream.next(rhythm);
    }
    stream.exposure_us = 5000.0;
    stream.t_ns += moved_ns;
    for (int i = 0; i < (moved_ns == 0.0 ? 1 : 3); ++i) {
      EXPECT_EQ(stream.next(rhythm).position, Position::learning) << moved_ns;
    }
    for (int i = 0; i < 10; ++i) {
      EXPECT_EQ(stream.next(rhythm).position, Position::on) << moved_ns;
    }
    EXPECT_EQ(stream.next(rhythm, 600e3).position, Position::off) << moved_ns;
  }
}

TEST(FrameRhythm, AFalseTimestampAfterAnotherExposureIsNotTakenForMovedOnesNorForTheOldRhythm) {
  for (const double moved_ns : {0.0, 600e3}) {
    Stream stream;
    FrameRhythm rhythm;
    for (int i = 0; i < 40; ++i) {
      (void)stream.next(rhythm);
    }
    stream.exposure_us = 5000.0;
    stream.t_ns += moved_ns;
    // Where the timestamps have moved, this one lies just on the old rhythm.
    EXPECT_EQ(stream.next(rhythm, -600e3).position, Position::learning);
    for (int i = 0; i < 12; ++i) {
      (void)stream.next(rhythm);
    }
    EXPECT_EQ(stream.next(rhythm).position, Position::on) << moved_ns;
    EXPECT_EQ(stream.next(rhythm, -600e3).position, Position::off) << moved_ns;
  }
}

TEST(FrameRhythm, ACameraThatChangesItsRateOrBeginsAnewIsLearntAnewAndSaysSo) {
  for (const double change : {0.5, 2.0, 1.01}) {
    Stream stream{.sigma_ns = 10e3};
    FrameRhythm rhythm;
    for (int i = 0; i < 100; ++i) {
      (void)stream.next(rhythm);
    }
    stream.period_ns *= change;
    stream.t_ns += 3.1e6;
    int n_anew = 0;
    int n_unused = 0;
    for (int i = 0; i < 60; ++i) {
      const FrameRhythm::Verdict verdict = stream.next(rhythm);
      n_anew += verdict.is_learnt_anew ? 1 : 0;
      n_unused += verdict.position != Position::on ? 1 : 0;
    }
    EXPECT_GE(n_anew, 1) << change;
    EXPECT_LE(n_unused, 16) << change;
    EXPECT_EQ(stream.next(rhythm).position, Position::on) << change;
  }
}

/// Real cameras: normal jitter and a clock that is 50 ppm off. Needless suspicion at most one
/// frame in a thousand, and every false timestamp that is let through lies within the guard.
TEST(FrameRhythm, HonestStreamsAreBelievedAndFalseTimestampsAreNotBeyondTheGuard) {
  const std::uint64_t seed = testing::drawn_seed();
  for (const double sigma_us : {0.0, 5.0, 20.0, 50.0, 500.0}) {
    for (const double false_fraction : {0.0, 0.05}) {
      Stream stream{.period_ns = 1e9 / 60.0 * (1.0 + 50e-6),
                    .sigma_ns = sigma_us * 1e3,
                    .seed = hash_key(seed, static_cast<std::uint64_t>(sigma_us))};
      FrameRhythm rhythm;
      int n_true = 0;
      int n_suspected = 0;
      int n_false = 0;
      int n_caught = 0;
      double worst = 0.0;
      for (std::uint64_t i = 0; i < 20'000; ++i) {
        const bool is_false = i > 8 && uniform_unit(hash_key(seed, i, 5)) < false_fraction;
        const double lie_ns = is_false
                                  ? (uniform_unit(hash_key(seed, i, 6)) < 0.5 ? -1.0 : 1.0) *
                                        (0.1e6 + 1.8e6 * uniform_unit(hash_key(seed, i, 7)))
                                  : 0.0;
        const FrameRhythm::Verdict verdict = stream.next(rhythm, lie_ns);
        n_true += is_false ? 0 : 1;
        n_false += is_false ? 1 : 0;
        n_suspected += !is_false && verdict.position == Position::off ? 1 : 0;
        n_caught += is_false && verdict.position == Position::off ? 1 : 0;
        if (verdict.position == Position::on) {
          worst = std::max(worst,
                           std::abs(stream.error_ns) / static_cast<double>(verdict.guard_ns));
        }
      }
      fmt::print(
          "sigma {:5.1f} us, {:2.0f} % false: {} of {} true timestamps suspected ({:.4f} %), "
          "{} of "
          "{} false ones caught, the rest wrong by {:.2f} of the guard at most\n",
          sigma_us, 100.0 * false_fraction, n_suspected, n_true, 100.0 * n_suspected / n_true,
          n_caught, n_false, worst);
      EXPECT_LE(n_suspected, n_true / 1000) << sigma_us;
      EXPECT_LE(worst, 1.1) << sigma_us;  // 1, and the fit's own error of the first frames
    }
  }
}

}  // namespace
}  // namespace haarlight::capture
