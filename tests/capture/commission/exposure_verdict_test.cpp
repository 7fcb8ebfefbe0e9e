// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/exposure_verdict.h"

#include <cmath>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"

/// @file
/// Is an exposure as long as the camera says? Samples are made on the line that exposures of
/// `scale` times what is said give, with a wave of known size about it: the wave is what the
/// jackknife makes its sigma of, and hardly moves the slope.

namespace haarlight::capture {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr double kLongUs = 4000.0;
constexpr double kShortUs = 2000.0;

/// `n` steps at each exposure, seen in part, numbered from `first`.
std::vector<StepSample> made(double scale, double wave, int n, int first = 0) {
  std::vector<StepSample> samples;
  for (const double e : {kLongUs, kShortUs}) {
    for (int i = 0; i < n; ++i) {
      const double fraction = 0.2 + 0.6 * (i + 0.5) / n;
      StepSample s;
      s.step = first + i + (e == kShortUs ? 100'000 : 0);
      s.rises = true;
      s.exposure_us = e;
      s.after_us = fraction * e * scale;
      s.level = fraction + wave * std::cos(2.0 * std::numbers::pi * 4.0 * (i + 0.5) / n);
      s.sigma = 0.001;
      samples.push_back(s);
    }
  }
  return samples;
}

/// The wave that makes the long exposure's scale lie `sigmas` of its sigma from 1.
double wave_for(double scale, double sigmas, int n) {
  double low = 0.0;
  double high = 0.1;
  for (int i = 0; i < 60; ++i) {
    const double wave = 0.5 * (low + high);
    const auto found = exposure_scale(made(scale, wave, n), kLongUs);
    (std::abs(found->value - 1.0) > sigmas * found->sigma ? low : high) = wave;
  }
  return low;
}

const ExposureQuestion kQuestion{kLongUs, kShortUs, kDoubtSigmas, "/dev/video7"};

TEST(ExposureVerdict, NeedsMoreSigmasOfFewStepsThanOfMany) {
  // Student's t with the chance of 4 sigmas: 4.3 of 60 steps, 6.6 of 13.
  for (const auto& [n, sigmas, kind] :
       {std::tuple{60, 1.9, ExposureVerdict::as_said},
        std::tuple{60, 2.1, ExposureVerdict::open}, std::tuple{60, 4.1, ExposureVerdict::open},
        std::tuple{60, 4.6, ExposureVerdict::wrong}, std::tuple{13, 4.6, ExposureVerdict::open},
        std::tuple{13, 6.2, ExposureVerdict::open},
        std::tuple{13, 7.0, ExposureVerdict::wrong}}) {
    const double wave = wave_for(1.1, sigmas, n);
    EXPECT_EQ(assess_exposure(made(1.1, wave, n), kQuestion).kind, kind)
        << n << " steps, " << sigmas << " sigmas";
  }
  // Within 4 % nothing is said however sure it is; where nothing was seen, nothing is known.
  EXPECT_EQ(assess_exposure(made(1.03, 0.0, 60), kQuestion).kind, ExposureVerdict::as_said);
  EXPECT_EQ(assess_exposure({}, kQuestion).kind, ExposureVerdict::as_said);
}

/// What commissioning must not do with a fact that it cannot measure: pass it over.
TEST(ExposureVerdict, SaysThatItStaysOpenWhenFurtherStepsTellNoMore) {
  auto samples = made(1.1, wave_for(1.1, 4.1, 60), 60);
  std::vector<int> rounds;
  std::string problem;
  try {
    require_true_exposure(
        kQuestion, [&] { return samples; }, [&](int round) { rounds.push_back(round); });
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::bad_input);
    problem = error.what();
  }
  EXPECT_THAT(problem, AllOf(HasSubstr("it may be that an exposure of 4000 us lasts 1."),
                             HasSubstr("60 steps leave it open"), HasSubstr("/dev/video7"),
                             HasSubstr("commission again")));
  EXPECT_THAT(rounds, ElementsAre(1, 2, 3, 4, 5, 6, 7, 8));
}

TEST(ExposureVerdict, IsSettledByFurtherSteps) {
  const auto start = made(1.1, wave_for(1.1, 3.0, 20), 20);
  for (const double truth : {1.0, 1.1}) {
    auto samples = start;
    int n_rounds = 0;
    std::string problem;
    try {
      require_true_exposure(
          kQuestion, [&] { return samples; },
          [&](int round) {
            n_rounds = round;
            const auto further = made(truth, 0.0, 40, 1000 * round);
            samples.insert(samples.end(), further.begin(), further.end());
          });
    } catch (const Error& error) {
      problem = error.what();
    }
    EXPECT_GE(n_rounds, 1);
    EXPECT_LT(n_rounds, kMoreExposureRounds);
    if (truth == 1.0) {
      EXPECT_EQ(problem, "");
    } else {
      EXPECT_THAT(problem, AllOf(HasSubstr("lasts 1."), HasSubstr("then begin again")));
    }
  }
}

}  // namespace
}  // namespace haarlight::capture
