// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <numeric>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "capture/commission/light_survey.h"
#include "capture/commission/photon_transfer.h"
#include "capture/commission/step_response.h"
#include "capture/commission/timestamp_meaning.h"
#include "core/random.h"

namespace haarlight::capture {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// ---- step response ----

TEST(LitFraction, IsTheWindowedIntegralOfARamp) {
  // Inside the ramp, past it, and beyond the exposure: by hand from H(u).
  EXPECT_DOUBLE_EQ(lit_fraction(-1.0, 100.0, 20.0), 0.0);
  EXPECT_DOUBLE_EQ(lit_fraction(10.0, 100.0, 20.0), 100.0 / 40.0 / 100.0);
  EXPECT_DOUBLE_EQ(lit_fraction(60.0, 100.0, 20.0), 50.0 / 100.0);
  EXPECT_DOUBLE_EQ(lit_fraction(120.0, 100.0, 20.0), 1.0);
  EXPECT_DOUBLE_EQ(lit_fraction(50.0, 100.0, 0.0), 0.5);
  // A ramp longer than the exposure.
  EXPECT_NEAR(lit_fraction(100.0, 50.0, 200.0), 0.375, 1e-12);
}

RC_GTEST_PROP(LitFraction, AgreesWithNumericalIntegration, ()) {
  const double e = *rc::gen::inRange(10, 5000);
  const double ramp = *rc::gen::inRange(1, 3000);
  const double x = *rc::gen::inRange(-1000, 9000);
  const int n = 20000;
  double sum = 0.0;
  for (int i = 0; i < n; ++i) {
    const double u = x - e + (i + 0.5) / n * e;
    sum += std::clamp(u / ramp, 0.0, 1.0) / n;
  }
  RC_ASSERT(std::abs(sum - lit_fraction(x, e, ramp)) < 1e-3 / ramp + 1e-6);
}

/// Steps at random phases as the model has them, without noise unless requested.
std::vector<StepSample> made_steps(const StepModel& truth, int n_steps, int n_rows,
                                   double noise, double jitter_us) {
  std::vector<StepSample> samples;
  for (std::size_t j = 0; j < truth.exposures_us.size(); ++j) {
    const double e = truth.exposures_us[j];
    for (int i = 0; i < n_steps; ++i) {
      const auto key = static_cast<std::uint64_t>(1000 * j + static_cast<std::size_t>(i));
      const double span = e + truth.rise_us + std::abs(truth.skew_us);
      const double x0 =
          -std::abs(truth.skew_us) - 0.1 * e + uniform_unit(hash_key(1, key)) * 1.2 * span;
      const double slip = jitter_us * standard_normal(hash_key(2, key));
      for (int row = 0; row < n_rows; ++row) {
        StepSample s;
        s.step = static_cast<int>(j) * n_steps + i;
        s.rises = i % 2 == 0;
        s.exposure_us = e;
        s.row = n_rows > 1 ? static_cast<double>(row) / (n_rows - 1) : 0.0;
        s.after_us = x0 - e + truth.offset_us[j] + slip;
        const double x = x0 + s.row * truth.skew_us;
        const double fraction = lit_fraction(x, e, s.rises ? truth.rise_us : truth.fall_us);
        s.level = (s.rises ? fraction : 1.0 - fraction) +
                  noise * standard_normal(hash_key(3, key, static_cast<std::uint64_t>(row)));
        s.sigma = std::max(noise, 1e-4);
        s.jitter_us = std::max(jitter_us, 0.5);
        samples.push_back(s);
      }
    }
  }
  return samples;
}

TEST(FitSteps, RecoversAnExactModelOfARollingShutter) {
  const StepModel truth{{500.0, 4000.0}, {13312.0, 16812.0}, 15000.0, 140.0, 60.0};
  const auto fit = fit_steps(made_steps(truth, 40, 32, 0.0, 0.0));
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->model.offset_us[0], 13312.0, 0.5);
  EXPECT_NEAR(fit->model.offset_us[1], 16812.0, 0.5);
  EXPECT_NEAR(fit->model.skew_us, 15000.0, 0.5);
  EXPECT_NEAR(fit->model.rise_us, 140.0, 1.0);
  EXPECT_NEAR(fit->model.fall_us, 60.0, 1.0);
  EXPECT_NEAR(offset_line(*fit).slope, 1.0, 1e-3);
}

TEST(FitSteps, RecoversAnExactModelOfAGlobalShutter) {
  const StepModel truth{{500.0, 4000.0}, {812.0, 812.0}, 0.0, 140.0, 60.0};
  const auto fit = fit_steps(made_steps(truth, 60, 8, 0.0, 0.0));
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->model.offset_us[0], 812.0, 0.5);
  EXPECT_NEAR(fit->model.skew_us, 0.0, 0.5);
  EXPECT_NEAR(fit->model.rise_us, 140.0, 1.0);
  EXPECT_NEAR(offset_line(*fit).slope, 0.0, 1e-3);
}

TEST(FitSteps, StatesItsUncertaintyHonestly) {
  // 20 data sets: the mean square of (error / sigma) is 1 within what 20 of them can show, for
  // offset, rise and fall; the jackknife's own scatter widens it.
  const StepModel truth{{500.0, 4000.0}, {812.0, 812.0}, 0.0, 140.0, 60.0};
  double sum = 0.0;
  int n = 0;
  for (int set = 0; set < 20; ++set) {
    auto samples = made_steps(truth, 60, 4, 0.0, 0.0);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const auto key = hash_key(9, static_cast<std::uint64_t>(set));
      samples[i].level += 0.004 * standard_normal(hash_key(key, i));
      samples[i].after_us +=
          8.0 * standard_normal(hash_key(key, 7, static_cast<std::uint64_t>(samples[i].step)));
      samples[i].sigma = 0.004;
      samples[i].jitter_us = 8.0;
    }
    StepFitOptions options;
    options.slope = 0.0;
    const auto fit = fit_steps(samples, options);
    ASSERT_TRUE(fit);
    const double z[] = {(fit->model.offset_us[0] - 812.0) / fit->offset_sigma_us[0],
                        (fit->model.rise_us - 140.0) / fit->rise_sigma_us,
                        (fit->model.fall_us - 60.0) / fit->fall_sigma_us};
    for (const double one : z) {
      sum += one * one;
      ++n;
    }
  }
  EXPECT_GT(sum / n, 0.5);
  EXPECT_LT(sum / n, 2.0);
}

TEST(FitSteps, RowsOfOneStepShareItsDelay) {
  // The light comes 0 to 356 us late, another amount at each step; noise of 0.1 %. Taken for
  // noise of each sample this moved the skew by 34 us, and the jackknife said 2. 20 data sets:
  // the sum of 20 squares of Student's t is above 60 once in 10 000.
  const StepModel truth{{650.0, 5200.0}, {4424.0, 4424.0}, 2905.0, 423.0, 40.0};
  double sum = 0.0;
  double worst = 0.0;
  for (std::uint64_t set = 0; set < 20; ++set) {
    auto samples = made_steps(truth, 40, 16, 0.0, 0.0);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      StepSample& s = samples[i];
      s.after_us += 356.0 * uniform_unit(hash_key(12, set, static_cast<std::uint64_t>(s.step)));
      s.level += 0.001 * standard_normal(hash_key(13, set, i));
      s.sigma = 0.001;
      s.jitter_us = 10.0;
    }
    StepFitOptions options;
    options.slope = 0.0;
    options.scatter_us = 356.0 / std::sqrt(12.0);
    options.has_own_delays = true;
    const auto fit = fit_steps(samples, options);
    ASSERT_TRUE(fit);
    const double error = fit->model.skew_us - truth.skew_us;
    worst = std::max(worst, std::abs(error));
    sum += error * error / (fit->skew_sigma_us * fit->skew_sigma_us);
  }
  EXPECT_LT(worst, 5.0);
  EXPECT_LT(sum, 60.0);
  EXPECT_GT(sum, 5.0);
}

TEST(FitSteps, IsNotMovedByAFewWildSteps) {
  const StepModel truth{{500.0, 4000.0}, {812.0, 812.0}, 0.0, 140.0, 60.0};
  auto samples = made_steps(truth, 60, 4, 0.002, 5.0);
  for (StepSample& s : samples) {
    if (s.step % 20 == 3) {
      s.after_us += 3000.0;  // an acknowledgement that was 3 ms late
    }
  }
  const auto fit = fit_steps(samples);
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->model.offset_us[1], 812.0, 30.0);
}

/// An LED that settles as 1 - exp(-t / tau) has no end of its ramp; the fit gives the straight
/// line that fits best. The fraction of an exposure E that begins with the light is
/// 1 - tau (1 - exp(-x / tau)) / E.
TEST(FitSteps, AnExponentialLightGivesTheLengthOfAStraightLine) {
  for (const double tau : {50.0, 100.0, 200.0}) {
    const StepModel even{{500.0, 4000.0}, {812.0, 812.0}, 0.0, 4.0 * tau, 4.0 * tau};
    auto samples = made_steps(even, 120, 8, 0.0, 0.0);
    for (std::size_t i = 0; i < samples.size(); ++i) {
      StepSample& s = samples[i];
      const double x = s.after_us + s.exposure_us - 812.0;  // end of exposure after the light
      const auto lit = [tau](double t) {
        return t > 0.0 ? t - tau * -std::expm1(-t / tau) : 0.0;
      };
      const double fraction = (lit(x) - lit(x - s.exposure_us)) / s.exposure_us;
      s.level = (s.rises ? fraction : 1.0 - fraction) + 0.002 * standard_normal(hash_key(5, i));
      s.sigma = 0.002;
    }
    const auto fit = fit_steps(samples);
    ASSERT_TRUE(fit);
    fmt::print(
        "tau {} us: rise {:.2f} tau, fall {:.2f} tau, offsets {:.2f} and {:.2f} tau late\n",
        tau, fit->model.rise_us / tau, fit->model.fall_us / tau,
        (fit->model.offset_us[0] - 812.0) / tau, (fit->model.offset_us[1] - 812.0) / tau);
  }
}

TEST(ExposureScale, IsTheSlopeOfTheFraction) {
  const StepModel truth{{4000.0}, {812.0}, 3000.0, 140.0, 60.0};
  auto samples = made_steps(truth, 60, 8, 0.002, 5.0);
  const auto scale = exposure_scale(samples, 4000.0);
  ASSERT_TRUE(scale);
  EXPECT_NEAR(scale->value, 1.0, 4.0 * scale->sigma);
  EXPECT_LT(scale->sigma, 0.005);
  EXPECT_GT(scale->sigma, 0.0001);
  for (StepSample& s : samples) {
    s.exposure_us = 3200.0;  // what the camera says
  }
  EXPECT_NEAR(exposure_scale(samples, 3200.0)->value, 1.25, 0.0125);
}

TEST(ExposureScale, ASlowLightLooksLikeALongerExposureButNotTwice) {
  const StepModel truth{{2000.0, 4000.0}, {812.0, 812.0}, 0.0, 4000.0, 4000.0};
  const auto samples = made_steps(truth, 60, 8, 0.002, 5.0);
  const double at_4000 = exposure_scale(samples, 4000.0)->value;
  const double at_2000 = exposure_scale(samples, 2000.0)->value;
  EXPECT_GT(at_4000, 1.04);
  EXPECT_GT(at_2000, 1.2 * at_4000);
}

TEST(ExposureScale, SaysNothingOfTooFewSteps) {
  const StepModel truth{{4000.0}, {812.0}, 0.0, 140.0, 60.0};
  EXPECT_FALSE(exposure_scale({}, 4000.0));
  EXPECT_FALSE(exposure_scale(made_steps(truth, 3, 8, 0.0, 0.0), 4000.0));
}

TEST(FitSteps, SaysNothingWithoutSteps) {
  EXPECT_FALSE(fit_steps({}));
  const StepModel truth{{500.0}, {812.0}, 0.0, 140.0, 60.0};
  auto samples = made_steps(truth, 40, 1, 0.0, 0.0);
  for (StepSample& s : samples) {
    s.level = s.rises ? 1.0 : 0.0;
  }
  EXPECT_FALSE(fit_steps(samples));
}

// ---- timestamps ----

TEST(ControlPhase, IsNarrowedFromBothSides) {
  // Frames begin at 0, 100, 200 ...; an exposure set at t is first in force in the frame after
  // the next, whose reference is 30 after its start: phase = 30 + 100.
  std::vector<ControlTrial> trials;
  for (const double t : {3.0, 55.0, 98.0, 101.0, 149.0}) {
    const double start = std::ceil(t / 100.0) * 100.0 + 100.0;
    trials.push_back({t - 0.5, t + 0.5, start + 30.0});
  }
  const auto phase = control_phase(trials, 100.0, 1.0);
  ASSERT_TRUE(phase);
  EXPECT_LE(phase->low_us, 130.0);
  EXPECT_GE(phase->high_us, 130.0);
  EXPECT_NEAR(phase->value_us(), 130.0, 2.0);
  trials.push_back({0.0, 0.1, 430.0});
  EXPECT_FALSE(control_phase(trials, 100.0, 1.0));
  EXPECT_FALSE(control_phase({}, 100.0, 1.0));
}

TimestampEvidence evidence(double slope, double offset_us, double arrival_us) {
  TimestampEvidence e;
  e.slope = slope;
  e.slope_sigma = 0.005;
  e.offset_us = offset_us;
  e.offset_sigma_us = 20.0;
  e.exposure_us = 8000.0;
  e.arrival_us = arrival_us;
  e.period_us = 33333.0;
  return e;
}

TEST(ClassifyTimestamp, TellsTheThreeMeanings) {
  TimestampEvidence e = evidence(0.004, 812.0, 8000.0 + 12200.0);
  e.control = ControlPhase{-10.0, 30.0, 20};
  auto v = classify_timestamp(e);
  ASSERT_TRUE(v);
  EXPECT_EQ(v->meaning, TimestampMeaning::start_exposure);
  EXPECT_EQ(v->latch_us.value, 812.0);
  EXPECT_EQ(v->exposure_delay_frames->value, 0.0);
  EXPECT_NEAR(v->ready_us.value, 12200.0, 1e-9);
  EXPECT_FALSE(v->read_us);

  e = evidence(0.998, 812.0, 12200.0);
  e.control = ControlPhase{33300.0, 33350.0, 20};
  v = classify_timestamp(e);
  ASSERT_TRUE(v);
  EXPECT_EQ(v->meaning, TimestampMeaning::start_readout);
  EXPECT_EQ(v->exposure_delay_frames->value, 1.0);

  e = evidence(1.002, 12812.0, 200.0);
  e.control = ControlPhase{2 * 33333.0 + 11990.0, 2 * 33333.0 + 12010.0, 20};
  v = classify_timestamp(e);
  ASSERT_TRUE(v);
  EXPECT_EQ(v->meaning, TimestampMeaning::end_frame);
  EXPECT_EQ(v->exposure_delay_frames->value, 2.0);
  EXPECT_NEAR(v->read_us->value, 12000.0, 1e-6);
  EXPECT_NEAR(v->latch_us.value, 812.0, 1e-6);
  EXPECT_NEAR(v->ready_us.value, 12200.0, 1e-6);
}

TEST(ClassifyTimestamp, UsesTheSkewOfARollingShutter) {
  // The light's delay is longer than the readout: arrival alone would say "end of frame", but
  // a frame cannot reach the host before its last row.
  TimestampEvidence e = evidence(1.0, 20000.0, 15300.0);
  e.skew_us = 15000.0;
  auto v = classify_timestamp(e);
  ASSERT_TRUE(v);
  EXPECT_EQ(v->meaning, TimestampMeaning::end_frame);  // both fit; the shorter way is the end's
  e.offset_us = 9000.0;
  v = classify_timestamp(e);
  EXPECT_EQ(v->meaning, TimestampMeaning::start_readout);
  e.offset_us = 30000.0;
  e.arrival_us = 400.0;
  v = classify_timestamp(e);
  EXPECT_EQ(v->meaning, TimestampMeaning::end_frame);
}

TEST(ClassifyTimestamp, SaysWhenOnlyTheSumIsMeasured) {
  TimestampEvidence e = evidence(1.0, 12812.0, 200.0);
  e.written_latch_us = 500.0;
  const auto v = classify_timestamp(e);
  ASSERT_TRUE(v);
  EXPECT_FALSE(v->is_divided);
  EXPECT_NEAR(v->latch_us.value + v->read_us->value, 12812.0, 1e-9);
  EXPECT_EQ(v->latch_us.value, 500.0);
  EXPECT_GT(v->read_us->sigma, 1000.0);
  EXPECT_THAT(v->evidence, HasSubstr("only the sum"));
}

TEST(ClassifyTimestamp, RefusesATimestampInTheMiddle) {
  EXPECT_FALSE(classify_timestamp(evidence(0.5, 812.0, 8000.0)));
  TimestampEvidence vague = evidence(0.0, 812.0, 8000.0);
  vague.slope_sigma = 0.3;
  EXPECT_FALSE(classify_timestamp(vague));
}

// ---- noise ----

struct MadeSensor {
  double gain = 0.92;
  double read = 4.1;
  double full_well = 14500.0;
  double black = 200.0;
  int white = 16383;

  [[nodiscard]] Image<std::uint16_t> picture(double electrons, std::uint64_t seed,
                                             double drift = 1.0) const {
    Image<std::uint16_t> image(100, 200, 1);
    for (int y = 0; y < 100; ++y) {
      for (int x = 0; x < 200; ++x) {
        // Uneven light and a fixed pattern of 3 %.
        const auto position =
            static_cast<std::uint64_t>(y) * 200U + static_cast<std::uint64_t>(x);
        const double fixed = 1.0 + 0.03 * standard_normal(hash_key(77, position));
        const double mean = drift * electrons * (0.4 + 0.6 * x / 199.0) * fixed;
        const double e =
            mean + std::sqrt(mean + read * read) * standard_normal(hash_key(seed, position));
        const double word = std::floor(black + std::min(e, full_well) / gain + 0.5);
        image(y, x) = static_cast<std::uint16_t>(std::clamp(word, 0.0, 1.0 * white));
      }
    }
    return image;
  }
};

TEST(MeasureSensor, RecoversAMadeSensor) {
  const MadeSensor sensor;
  TransferCurve curve(sensor.white);
  DarkLevel dark;
  std::vector<ExposureLevel> levels;
  for (std::uint64_t i = 0; i < 3; ++i) {
    add_dark_pair(sensor.picture(0.0, 2 * i + 1).view(), sensor.picture(0.0, 2 * i + 2).view(),
                  100, dark);
  }
  for (std::uint64_t level = 1; level <= 9; ++level) {
    const double electrons = 1400.0 * static_cast<double>(level);
    // The lamp is 1 % brighter in the second picture of each pair.
    const auto a = sensor.picture(electrons, 100 + 2 * level);
    const auto b = sensor.picture(electrons, 101 + 2 * level, 1.01);
    curve.add_pair(a.view(), b.view(), 100);
    const auto words = a.pixels();
    levels.push_back({100.0 * static_cast<double>(level),
                      std::accumulate(words.begin(), words.end(), 0.0) / 20000.0});
  }
  const auto full = find_saturation(sensor.picture(60000.0, 900).view(),
                                    sensor.picture(90000.0, 901).view(), 100, 1.5, 200.0);
  ASSERT_TRUE(full);
  EXPECT_NEAR(*full, 200.0 + 14500.0 / 0.92, 1.0);
  const auto m = measure_sensor(curve, dark, full, sensor.white, levels);
  ASSERT_TRUE(m);
  EXPECT_NEAR(m->gain_e_per_dn.value, 0.92, 0.03 * 0.92);
  EXPECT_NEAR(m->gain_e_per_dn.value, 0.92, 5.0 * m->gain_e_per_dn.sigma);
  EXPECT_NEAR(m->read_e.value, 4.1, 0.03 * 4.1);
  EXPECT_NEAR(m->black_dn.value, 200.0, 0.1);
  EXPECT_NEAR(m->full_well_e->value, 14500.0, 0.03 * 14500.0);
  EXPECT_LT(m->linearity_percent->value, 0.2);
  EXPECT_FALSE(m->is_read_from_curve);
  EXPECT_FALSE(m->is_converter_limited);
}

TEST(MeasureSensor, SeesACurvedResponse) {
  std::vector<ExposureLevel> levels;
  for (int i = 1; i <= 20; ++i) {
    const double t = 50.0 * i;
    levels.push_back({t, 200.0 + 10.0 * t * (1.0 - 1e-4 * t)});  // 10 % lost at the top
  }
  const MadeSensor sensor;
  TransferCurve curve(sensor.white);
  DarkLevel dark;
  add_dark_pair(sensor.picture(0.0, 1).view(), sensor.picture(0.0, 2).view(), 100, dark);
  for (std::uint64_t i = 1; i < 8; ++i) {
    curve.add_pair(sensor.picture(1500.0 * static_cast<double>(i), 2 * i).view(),
                   sensor.picture(1500.0 * static_cast<double>(i), 2 * i + 1).view(), 100);
  }
  const auto m = measure_sensor(curve, dark, std::nullopt, sensor.white, levels);
  ASSERT_TRUE(m);
  EXPECT_GT(m->linearity_percent->value, 1.0);
  EXPECT_FALSE(m->full_well_e);
}

TEST(MeasureSensor, DistrustsDarkPixelsThatClip) {
  MadeSensor sensor;
  sensor.black = 2.0;
  DarkLevel dark;
  TransferCurve curve(sensor.white);
  add_dark_pair(sensor.picture(0.0, 1).view(), sensor.picture(0.0, 2).view(), 100, dark);
  EXPECT_GT(dark.clipped_fraction, 0.1);
  for (std::uint64_t i = 1; i < 9; ++i) {
    curve.add_pair(sensor.picture(400.0 * static_cast<double>(i * i), 2 * i).view(),
                   sensor.picture(400.0 * static_cast<double>(i * i), 2 * i + 1).view(), 100);
  }
  const auto m = measure_sensor(curve, dark, std::nullopt, sensor.white, {});
  ASSERT_TRUE(m);
  EXPECT_TRUE(m->is_read_from_curve);
  EXPECT_NEAR(m->gain_e_per_dn.value, 0.92, 0.03);
}

TEST(MeasureSensor, SaysNothingOfTooFewLevels) {
  const MadeSensor sensor;
  TransferCurve curve(sensor.white);
  EXPECT_FALSE(measure_sensor(curve, {}, std::nullopt, sensor.white, {}));
  EXPECT_FALSE(find_saturation(sensor.picture(2000.0, 1).view(),
                               sensor.picture(3000.0, 2).view(), 100, 1.5, 200.0));
}

// ---- lights ----

Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

/// What an even floor gives, with the lights' own scatter of 2 % and a floor that is not matt.
std::vector<LightResponse> made_responses(const Rig& rig) {
  const std::vector<double> expected = expected_signals(rig, 0);
  const auto blocks = expected_blocks(rig, 0);
  const double top = *std::max_element(expected.begin(), expected.end());
  std::vector<LightResponse> responses;
  for (int k = 0; k < rig.n_lights(); ++k) {
    const LightElement light = light_element(rig, k);
    LightResponse r;
    const double gloss = 1.0 + 0.1 * (light.row - 3.5) / 3.5;
    r.signal = 4000.0 * expected[static_cast<std::size_t>(k)] / top * gloss *
               (1.0 + 0.02 * standard_normal(hash_key(5, static_cast<std::uint64_t>(k))));
    r.sigma = 1.0;
    // A picture with things in it, each block with noise of 0.3 %.
    for (std::size_t b = 0; b < kSurveyBlocks; ++b) {
      const double albedo = 0.2 + 0.8 * uniform_unit(hash_key(8, b));
      r.blocks[b] = r.signal * kSurveyBlocks * albedo * blocks[static_cast<std::size_t>(k)][b] /
                    expected[static_cast<std::size_t>(k)] *
                    (1.0 + 0.003 * standard_normal(hash_key(9, b, static_cast<unsigned>(k))));
      r.block_sigma[b] = 0.003 * r.blocks[b];
    }
    responses.push_back(r);
  }
  return responses;
}

TEST(SurveyLights, FindsNothingWrongWithAGoodArray) {
  const Rig rig = small_rig();
  const LightSurvey survey = survey_lights(rig, 0, made_responses(rig));
  EXPECT_THAT(survey.dead, IsEmpty());
  EXPECT_THAT(survey.dim, IsEmpty());
  EXPECT_THAT(survey.unseen, IsEmpty());
  EXPECT_THAT(survey.miswired, IsEmpty());
  EXPECT_TRUE(survey.can_see_wiring);
  for (const double p : survey.power) {
    EXPECT_NEAR(p, 1.0, 0.08);  // 4 sigma of 2 %
  }
}

TEST(SurveyLights, FindsDeadDimAndSwappedLights) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  responses[9].signal = 0.4;
  responses[41].signal = -0.3;
  responses[12].signal *= 0.6;
  responses[50].signal *= 1.25;
  std::swap(responses[20], responses[21]);
  std::swap(responses[0], responses[63]);
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_THAT(survey.dead, ElementsAre(9, 41));
  EXPECT_THAT(survey.dim, ElementsAre(12));
  EXPECT_THAT(survey.miswired, ElementsAre(0, 20, 21, 63));
  EXPECT_THAT(survey.miswired_to, ElementsAre(63, 21, 20, 0));
  EXPECT_NEAR(survey.power[12], 0.6, 0.05);
  EXPECT_NEAR(survey.power[50], 1.25, 0.1);
  EXPECT_EQ(survey.power[9], 0.0);
}

TEST(SurveyLights, GivesNoVerdictOnWhatIsNotSeen) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  for (LightResponse& r : responses) {
    r.sigma = 1000.0;
  }
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_EQ(survey.unseen.size(), 64U);
  EXPECT_THAT(survey.dead, IsEmpty());
}

TEST(SurveyLights, DoesNotGuessWiringFromABlurredPicture) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  for (std::size_t k = 0; k < responses.size(); ++k) {
    // A diffuser: every light fills the picture alike.
    for (std::size_t b = 0; b < kSurveyBlocks; ++b) {
      responses[k].blocks[b] =
          responses[k].signal * (1.0 + 0.02 * standard_normal(hash_key(6, k, b)));
      responses[k].block_sigma[b] = 0.02 * responses[k].signal;
    }
  }
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_FALSE(survey.can_see_wiring);
  EXPECT_THAT(survey.miswired, IsEmpty());
}

/// Shadows that no smooth surface over the lights has: each light's blocks scatter by
/// `fraction`.
void shade(std::size_t k, double fraction, std::vector<LightResponse>& responses) {
  for (std::size_t b = 0; b < kSurveyBlocks; ++b) {
    responses[k].blocks[b] *= std::exp(fraction * standard_normal(hash_key(77, k, b)));
  }
}

TEST(SurveyLights, FindsASwappedPairThatFitsNoPositionWell) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  // Neighbours 62 and 63 differ by far more than 0.02 in most blocks, but their misfit in each
  // other's position is many times that of the others: before, neither was called miswired.
  std::swap(responses[62], responses[63]);
  shade(62, 0.02, responses);
  shade(63, 0.02, responses);
  shade(5, 0.02, responses);  // stands where it should
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_THAT(survey.miswired, ElementsAre(62, 63));
  EXPECT_THAT(survey.miswired_to, ElementsAre(63, 62));
  EXPECT_THAT(survey.unplaced, IsEmpty());
  EXPECT_TRUE(survey.can_see_wiring);
}

TEST(SurveyLights, NamesALightThatFitsNoPosition) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  shade(27, 2.0, responses);
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_THAT(survey.unplaced, ElementsAre(27));
  EXPECT_THAT(survey.miswired, IsEmpty());
  EXPECT_FALSE(survey.can_see_wiring);
}

/// Light 40 gives the picture of light 12's position, shaded; but 12 itself stands there.
TEST(SurveyLights, TwoLightsCannotStandInOnePosition) {
  const Rig rig = small_rig();
  auto responses = made_responses(rig);
  responses[40] = responses[12];
  shade(40, 0.03, responses);
  const LightSurvey survey = survey_lights(rig, 0, responses);
  EXPECT_THAT(survey.unplaced, ElementsAre(40));
  EXPECT_THAT(survey.miswired, IsEmpty());
}

}  // namespace
}  // namespace haarlight::capture
