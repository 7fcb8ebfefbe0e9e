// SPDX-License-Identifier: Apache-2.0
#include "capture/plan/advice.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

const std::string kRigs = HAARLIGHT_SOURCE_DIR "/configs/rigs/";

Rig small_rig() { return read_rig(kRigs + "small8.toml"); }

/// Every pixel sees `electrons` of every light; the plate is the same everywhere.
AdviceScene flat_scene(int n_lights, double electrons) {
  AdviceScene scene;
  scene.n_lights = n_lights;
  scene.n_pixels = 40;
  scene.electrons.assign(std::size_t{40} * static_cast<std::size_t>(n_lights),
                         static_cast<float>(electrons));
  scene.plate.assign(std::size_t{40} * static_cast<std::size_t>(n_lights), 1.0F);
  scene.resolves_lights = true;
  return scene;
}

CameraSpec camera_of(double read_e) {
  CameraSpec camera = small_rig().cameras.front();
  camera.noise.read_e = read_e;
  camera.noise.gain_e_per_dn = 1e-3;  // no rounding: the closed forms leave it out
  return camera;
}

PlanSettings settings_of(const std::string& text) {
  PlanSettings settings = parse_plan_file("schema = 1\nname = \"p\"\n" + text, "p.toml");
  settings.name = settings.patterns == PlanPatterns::one_at_a_time ? "one_at_a_time" : "p";
  return settings;
}

FamilyAdvice evaluated(const Rig& rig, const AdviceScene& scene, const std::string& text) {
  return advise(rig, scene, {single_lights(64, 8)}, {settings_of(text)}, nullptr).families[0];
}

TEST(Advice, OneLightsNoiseIsReadAndPhotonNoise) {
  const PatternInverse inverse({PatternFamily::one_at_a_time, {{1, 3}}, 0, {}},
                               {{{0, 1.0}}, {{1, 1.0}}, {{2, 1.0}}}, 3);
  const Prediction p =
      predict(inverse, flat_scene(3, 50.0), camera_of(7.0), 2000.0, 0, single_lights(3, 3), {});
  EXPECT_NEAR(p.noise_e, std::sqrt(49.0 + 50.0), 1e-4);
  EXPECT_EQ(p.bias_e, 0.0);
  EXPECT_NEAR(p.psnr_db, 20.0 * std::log10(50.0 / std::sqrt(99.0)), 1e-4);
}

TEST(Advice, TheExposureAndTheDarksEnterAsTheyShould) {
  const PatternInverse inverse({PatternFamily::one_at_a_time, {{1, 2}}, 0, {}},
                               {{{0, 1.0}}, {{1, 1.0}}}, 2);
  AdviceLighting both{"both", Eigen::MatrixXd::Ones(2, 1)};
  // Four times the exposure: signal x 4; all in electrons at the rig's exposure. The dark's
  // noise is in both lights: (1 + 1)^2 r^2 / n_darks.
  const Prediction p =
      predict(inverse, flat_scene(2, 50.0), camera_of(7.0), 8000.0, 5, both, {});
  EXPECT_NEAR(p.noise_e * p.noise_e, (2.0 * (49.0 + 200.0) + 4.0 * 49.0 / 5.0) / 16.0, 1e-4);
}

TEST(Advice, SMatrixGainIsTheFormula) {
  const PatternParameters parameters{PatternFamily::s_matrix, {{9, 7}}, 0, {}};
  std::vector<std::vector<LightDriveLevel>> shots;
  std::vector<std::vector<LightDriveLevel>> singles;
  for (const auto& lit : lit_lights(parameters)) {
    shots.emplace_back();
    for (const int k : lit) {
      shots.back().push_back({k, 1.0});
    }
    singles.push_back({{static_cast<int>(singles.size()), 1.0}});
  }
  const PatternInverse s(parameters, shots, 63);
  const PatternInverse one({PatternFamily::one_at_a_time, {{9, 7}}, 0, {}}, singles, 63);
  for (const double signal : {0.5, 10.0, 1000.0}) {
    const AdviceScene scene = flat_scene(63, signal);
    const AdviceLighting light = single_lights(63, 63);
    const double a = predict(one, scene, camera_of(6.0), 2000.0, 0, light, {}).noise_e;
    const double b = predict(s, scene, camera_of(6.0), 2000.0, 0, light, {}).noise_e;
    // The formula takes (n + 1)/n for 1: 4 r^2 n/(n + 1)^2 and 2 s n/(n + 1).
    EXPECT_NEAR(a * a / (b * b), s_matrix_gain2(6.0, signal, 63),
                0.035 * s_matrix_gain2(6.0, signal, 63));
  }
}

TEST(Advice, BiasIsWhatABlockHidesAndThePilotsNoiseIsTakenOff) {
  // Two lights in one block, equal plate; the object sees only the first.
  AdviceScene scene = flat_scene(2, 0.0);
  for (std::size_t p = 0; p < 40; ++p) {
    scene.electrons[2 * p] = 100.0F;
  }
  const PatternInverse inverse({PatternFamily::target, {}, 0, {}}, {{{0, 1.0}, {1, 1.0}}}, 2);
  AdviceLighting first{"first", Eigen::MatrixXd::Zero(2, 1)};
  first.weights(0, 0) = 1.0;
  const Prediction p = predict(inverse, scene, camera_of(3.0), 2000.0, 0, first, {});
  EXPECT_NEAR(p.bias_e, 50.0, 1e-6);
  // With noise of variance 16 in the pilot's values (c = +-1/2) the estimate stays 2500.
  AdviceScene noisy = scene;
  noisy.n_pixels = 20000;
  noisy.electrons.clear();
  for (std::uint64_t i = 0; i < 40000; ++i) {
    noisy.electrons.push_back(
        static_cast<float>((i % 2 == 0 ? 100.0 : 0.0) + 4.0 * standard_normal(hash_key(5, i))));
  }
  noisy.variance.assign(40000, 16.0F);
  noisy.plate.assign(40000, 1.0F);
  const Prediction q = predict(inverse, noisy, camera_of(3.0), 2000.0, 0, first, {});
  EXPECT_NEAR(q.bias_e * q.bias_e, 2500.0, 5.0 * q.bias2_sigma);
  EXPECT_LT(q.bias2_sigma, 3.0);
}

TEST(Advice, WithoutAPilotABlocksBiasIsNotKnown) {
  AdviceScene scene = flat_scene(64, 100.0);
  scene.resolves_lights = false;
  const FamilyAdvice bins = evaluated(small_rig(), scene, "patterns = \"bins\"\nbin = 4\n");
  EXPECT_TRUE(std::isnan(bins.predictions[0].psnr_db));
  EXPECT_TRUE(std::isfinite(bins.predictions[0].noise_psnr_db));
  const FamilyAdvice one = evaluated(small_rig(), scene, "patterns = \"one_at_a_time\"\n");
  EXPECT_TRUE(std::isfinite(one.predictions[0].psnr_db));
}

TEST(Advice, MultiplexingIsRefusedInBrightLightAndAdvisedInTheDark) {
  const FamilyAdvice bright =
      evaluated(small_rig(), flat_scene(64, 400.0), "patterns = \"s_matrix\"\n");
  ASSERT_FALSE(bright.refusals.empty());
  EXPECT_THAT(bright.refusals[0], HasSubstr("gain^2 = "));
  const FamilyAdvice dark =
      evaluated(small_rig(), flat_scene(64, 1.0), "patterns = \"s_matrix\"\n");
  EXPECT_TRUE(dark.refusals.empty()) << dark.refusals[0];
  EXPECT_THAT(dark.notes.back(), HasSubstr("gain^2 = (r^2 + s)/(4 r^2/n + 2 s)"));
}

TEST(Advice, TheExposureIsShortenedUntilTheWellHolds) {
  // 32 lights of 4000 electrons in a well of 16000, full from 0.97 of it on (converter 16127).
  const FamilyAdvice s =
      evaluated(small_rig(), flat_scene(64, 4000.0), "patterns = \"s_matrix\"\n");
  EXPECT_NEAR(s.brightest_e, 128000.0, 1.0);
  const double collected = s.exposure_us / 2000.0 * s.brightest_e;
  EXPECT_NEAR(collected + 4.0 * std::sqrt(collected + 9.0), 0.97 * 16000.0, 2.0);
  EXPECT_THAT(s.notes[0], HasSubstr("longest exposure"));
  EXPECT_EQ(s.plan.shots.front().exposure_us, s.exposure_us);
}

TEST(Advice, AWellThatNothingFitsIsRefused) {
  const FamilyAdvice s =
      evaluated(small_rig(), flat_scene(64, 4e6), "patterns = \"s_matrix\"\n");
  ASSERT_FALSE(s.refusals.empty());
  EXPECT_THAT(s.refusals[0], HasSubstr("saturates at every exposure"));
  EXPECT_TRUE(s.predictions.empty());
}

TEST(Advice, PowerStringsAndHeatAreRefusedWithTheirNumbers) {
  const AdviceScene scene = flat_scene(64, 1.0);
  Rig rig = small_rig();
  rig.faces[0].max_power = Watts(100.0);
  EXPECT_THAT(evaluated(rig, scene, "patterns = \"s_matrix\"\n").refusals[0],
              HasSubstr("100.0 W"));
  rig = small_rig();
  rig.faces[0].string_lights = 8;
  rig.faces[0].max_string_power = Watts(19.0);  // three lights of 5 W
  EXPECT_THAT(evaluated(rig, scene, "patterns = \"s_matrix\"\n").refusals[0],
              HasSubstr("more than 19.0 W on the string of light"));
  EXPECT_TRUE(evaluated(rig, scene, "patterns = \"one_at_a_time\"\n").refusals.empty());
  rig = small_rig();
  rig.faces[0].max_duty = 0.2;
  rig.faces[0].heat_tau_s = 0.1;
  EXPECT_THAT(evaluated(rig, scene, "patterns = \"s_matrix\"\n").refusals[0],
              HasSubstr("heats"));
  EXPECT_TRUE(evaluated(rig, scene, "patterns = \"one_at_a_time\"\n").refusals.empty());
}

TEST(Advice, DimmedShotsExposeWholePwmPeriods) {
  Rig rig = small_rig();
  rig.faces[0].pwm_hz = 1500.0;  // 666.7 us
  const FamilyAdvice dimmed =
      evaluated(rig, flat_scene(64, 100.0), "patterns = \"one_at_a_time\"\nlevel = 30000\n");
  EXPECT_TRUE(dimmed.refusals.empty());
  EXPECT_NEAR(dimmed.exposure_us, 2000.0, 1e-6);
  const FamilyAdvice bright =
      evaluated(rig, flat_scene(64, 30000.0), "patterns = \"one_at_a_time\"\nlevel = 60000\n");
  EXPECT_NEAR(bright.exposure_us, 2e6 / 3000.0, 1e-6) << "one period";
  const FamilyAdvice never =
      evaluated(rig, flat_scene(64, 60000.0), "patterns = \"one_at_a_time\"\nlevel = 60000\n");
  EXPECT_THAT(never.refusals.at(0), HasSubstr("multiple of 666.7 us"));
}

TEST(Advice, TheFastestThatReachesTheTargetIsAdvised) {
  const Rig rig = small_rig();
  const AdviceScene scene = flat_scene(64, 100.0);  // blocks hide nothing here
  AdviceOptions options;
  options.target_db = 15.0;
  const std::vector<PlanSettings> families = default_families(rig, false);
  Advice advice = advise(rig, scene, {single_lights(64, 8)}, families, nullptr, options);
  ASSERT_GE(advice.best, 0);
  EXPECT_EQ(advice.families[static_cast<std::size_t>(advice.best)].name, "bins_16");
  options.target_db = 90.0;
  EXPECT_EQ(advise(rig, scene, {single_lights(64, 8)}, families, nullptr, options).best, -1);
}

TEST(Advice, NeedsTheCamerasNoise) {
  Rig rig = small_rig();
  rig.cameras[0].noise = {};
  EXPECT_THROW((void)evaluated(rig, flat_scene(64, 1.0), "patterns = \"one_at_a_time\"\n"),
               Error);
}

TEST(PlanLimits, DimmingByPwmNeedsWholePeriods) {
  Rig rig = small_rig();
  rig.faces[0].pwm_hz = 1000.0;
  EXPECT_NO_THROW((void)expand_plan(
      settings_of("patterns = \"one_at_a_time\"\nlevel = 100\nexposures_us = [3000]\n"), rig));
  EXPECT_NO_THROW((void)expand_plan(
      settings_of("patterns = \"one_at_a_time\"\nexposures_us = [2500]\n"), rig));
  try {
    (void)expand_plan(
        settings_of("patterns = \"one_at_a_time\"\nlevel = 100\nexposures_us = [2500]\n"), rig);
    FAIL() << "2.5 periods";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("2.500 periods"));
  }
}

// An independent check: heat by small steps of Euler's method over the whole plan.
RC_GTEST_PROP(PlanLimits, NoAcceptedPlanOverheatsALight, ()) {
  Rig rig = small_rig();
  rig.faces[0].max_duty = *rc::gen::inRange(5, 60) / 100.0;
  rig.faces[0].heat_tau_s = *rc::gen::inRange(2, 50) / 100.0;
  PlanSettings settings;
  settings.name = "p";
  settings.patterns = PlanPatterns::list;
  for (int i = *rc::gen::inRange(1, 12); i > 0; --i) {
    settings.list.push_back({{*rc::gen::inRange(0, 3), 65535}});
  }
  bool is_accepted = true;
  Plan plan;
  try {
    plan = expand_plan(settings, rig);
  } catch (const Error&) {
    is_accepted = false;
    Rig cool = rig;
    cool.faces[0].max_duty = 1.0;
    plan = expand_plan(settings, cool);
  }
  double hottest = 0.0;
  double heat[3] = {0.0, 0.0, 0.0};
  for (const session::Shot& shot : plan.shots) {
    // 240 fps, 2 ms: two frame times per shot.
    constexpr int kSteps = 20000;
    const double dt = 2.0 / 240.0 / kSteps;
    for (int step = 0; step < kSteps; ++step) {
      for (int k = 0; k < 3; ++k) {
        const double drive = shot.lit[0].light == k ? 1.0 : 0.0;
        heat[k] += dt * (drive - heat[k]) / rig.faces[0].heat_tau_s;
        hottest = std::max(hottest, heat[k]);
      }
    }
  }
  const double limit = rig.faces[0].max_duty;
  if (std::abs(hottest - limit) > 1e-4) {
    RC_ASSERT(is_accepted == (hottest < limit));
  }
}

}  // namespace
}  // namespace haarlight::capture
