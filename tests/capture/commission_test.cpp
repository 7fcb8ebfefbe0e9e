#include "capture/commission.h"

#include <cmath>
#include <cstdlib>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/measured_camera.h"
#include "core/error.h"
#include "tests/capture/twin_bench.h"

/// @file
/// The whole commissioning against the simulator's sensor and controller on a virtual clock: it
/// is told a rig file that is wrong in every delay, stamp and noise figure, and must find the
/// truth.

namespace haarlight {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using testing::TwinBench;

constexpr double kReadUs = 12000.0;
constexpr double kSkewUs = 9000.0;

struct Case {
  TimestampMeaning meaning;
  Shutter shutter;
};

std::string case_name(const ::testing::TestParamInfo<Case>& info) {
  return fmt::format("{}_{}", to_string(info.param.meaning), to_string(info.param.shutter));
}

/// What the rig file claims: right in nothing that is to be measured.
Rig written_rig(Shutter shutter) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  CameraSpec& c = rig.cameras[0];
  c.fps = 40.0;
  c.exposure_us = 6000.0;
  c.shutter = shutter;
  c.skew_us = shutter == Shutter::rolling ? 1000.0 : 0.0;
  c.read_us = 1000.0;
  c.timestamp = TimestampMeaning::end_frame;
  c.noise = {2.0, 10.0, 30000.0, 64.0};
  return rig;
}

SimTruth truth_of(const Case& which) {
  SimTruth t;
  t.latch_us = 812.0;
  t.rise_us = 140.0;
  t.fall_us = 60.0;
  CameraTruth c;
  c.id = "main";
  c.timestamp = which.meaning;
  c.shutter = which.shutter;
  c.skew_us = which.shutter == Shutter::rolling ? kSkewUs : 0.0;
  c.read_us = kReadUs;
  c.exposure_delay_frames = 2;
  c.noise = SensorNoise{0.92, 4.1, 14500.0, 200.0};
  t.cameras.push_back(c);
  t.dead = {9, 41};
  t.dim = {{12, 0.6}, {50, 1.25}};
  t.swapped = {{20, 21}};
  return t;
}

/// The acceptance for delays: 0.1 ms or 1 %.
double delay_tolerance(double us) { return std::max(100.0, 0.01 * us); }

void expect_delay(const char* name, const std::optional<Measured>& m, double truth) {
  ASSERT_TRUE(m) << name;
  fmt::print("{:>8} {:9.1f} +- {:5.1f} us, error {:+7.1f}\n", name, m->value, m->sigma,
             m->value - truth);
  EXPECT_NEAR(m->value, truth, delay_tolerance(truth)) << name;
  // Its own figure of uncertainty is no fiction.
  EXPECT_LT(std::abs(m->value - truth), 6.0 * m->sigma + 5.0) << name;
}

void expect_share(const char* name, const std::optional<Measured>& m, double truth) {
  ASSERT_TRUE(m) << name;
  fmt::print("{:>8} {:9.3f} +- {:.3f}, error {:+.2f} %\n", name, m->value, m->sigma,
             100.0 * (m->value / truth - 1.0));
  EXPECT_NEAR(m->value, truth, 0.03 * truth) << name;
}

class CommissionCase : public ::testing::TestWithParam<Case> {};

void expect_the_truth(const Case& which, std::uint64_t seed) {
  const Rig rig = written_rig(which.shutter);
  TwinBench bench(rig, truth_of(which), seed);
  const CommissionResult r = commission(rig, bench.camera(), bench.lights(), {}, bench.clock());
  const MeasuredController& light = *r.measured.controller;
  const MeasuredCamera& camera = r.measured.cameras.at(0);
  fmt::print("{}\n", camera.evidence);
  EXPECT_EQ(camera.timestamp, which.meaning) << camera.evidence;
  expect_delay("latch", light.latch_us, 812.0);
  expect_delay("rise", light.rise_us, 140.0);
  expect_delay("fall", light.fall_us, 60.0);
  expect_delay("ready", camera.ready_us,
               which.shutter == Shutter::rolling ? kReadUs - kSkewUs + 200.0 : kReadUs + 200.0);
  if (which.meaning == TimestampMeaning::end_frame) {
    expect_delay("read", camera.read_us, kReadUs);
  } else {
    EXPECT_FALSE(camera.read_us);
  }
  if (which.shutter == Shutter::rolling) {
    expect_delay("skew", camera.skew_us, kSkewUs);
  }
  ASSERT_TRUE(camera.exposure_delay_frames);
  EXPECT_EQ(camera.exposure_delay_frames->value, 2.0);
  expect_share("gain", camera.gain_e_per_dn, 0.92);
  expect_share("read_e", camera.read_e, 4.1);
  expect_share("well", camera.full_well_e, 14500.0);
  expect_share("black", camera.black_dn, 200.0);
  ASSERT_TRUE(camera.linearity_percent);
  EXPECT_LT(camera.linearity_percent->value, 0.5);
  ASSERT_TRUE(r.survey);
  EXPECT_THAT(r.survey->dead, ElementsAre(9, 41));
  EXPECT_THAT(r.survey->dim, ElementsAre(12));
  EXPECT_THAT(r.survey->unseen, IsEmpty());
  EXPECT_THAT(r.survey->miswired, ElementsAre(20, 21));
  EXPECT_THAT(r.survey->miswired_to, ElementsAre(21, 20));
  EXPECT_NEAR(r.survey->power[12], 0.6, 0.02);
  EXPECT_NEAR(r.survey->power[50], 1.25, 0.03);
  EXPECT_THAT(r.contradictions, IsEmpty());
  EXPECT_TRUE(bench.controller().lit().pattern->empty());
  // Reading it back gives the rig the truth.
  Rig merged = rig;
  apply_measured(parse_measured(to_toml(r.measured), "m"), "m", merged);
  EXPECT_EQ(merged.cameras[0].timestamp, which.meaning);
  EXPECT_NEAR(merged.controller.latch_us, 812.0, 100.0);
}

TEST_P(CommissionCase, RecoversTheTruth) {
  // HAARLIGHT_SEEDS=20 for the table of docs/numerics/commissioning.md.
  const char* asked = std::getenv("HAARLIGHT_SEEDS");
  const int n = asked == nullptr ? 1 : std::atoi(asked);
  for (int seed = 1; seed <= n; ++seed) {
    SCOPED_TRACE(fmt::format("seed {}", seed));
    expect_the_truth(GetParam(), static_cast<std::uint64_t>(seed));
  }
}

INSTANTIATE_TEST_SUITE_P(
    SixCases, CommissionCase,
    ::testing::Values(Case{TimestampMeaning::start_exposure, Shutter::rolling},
                      Case{TimestampMeaning::start_readout, Shutter::rolling},
                      Case{TimestampMeaning::end_frame, Shutter::rolling},
                      Case{TimestampMeaning::start_exposure, Shutter::global},
                      Case{TimestampMeaning::start_readout, Shutter::global},
                      Case{TimestampMeaning::end_frame, Shutter::global}),
    case_name);

CommissionOptions only_timing() {
  CommissionOptions options;
  options.measures_noise = false;
  options.measures_lights = false;
  return options;
}

std::string failure_of(const Rig& rig, TwinBench& bench, const CommissionOptions& options) {
  try {
    (void)commission(rig, bench.camera(), bench.lights(), options, bench.clock());
  } catch (const Error& error) {
    EXPECT_TRUE(bench.controller().lit().pattern->empty()) << "lights are off after a failure";
    return error.what();
  }
  return "nothing was thrown";
}

TEST(Commission, SaysThatAShutterIsNotGlobal) {
  const Rig rig = written_rig(Shutter::global);
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::rolling}));
  const CommissionResult r =
      commission(rig, bench.camera(), bench.lights(), only_timing(), bench.clock());
  EXPECT_THAT(r.contradictions, ElementsAre(HasSubstr("shutter = \"rolling\"")));
}

TEST(Commission, LeavesTheLightsOffWhenTheCameraGoes) {
  const Rig rig = written_rig(Shutter::global);
  for (const int frames : {3, 40, 200, 500}) {
    TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
    bench.unplug_camera_after(frames);
    EXPECT_THAT(failure_of(rig, bench, only_timing()), HasSubstr("unplugged"));
  }
}

TEST(Commission, LeavesTheLightsOffWhenTheBusFails) {
  const Rig rig = written_rig(Shutter::global);
  for (const int requests : {0, 12, 60, 151, 400}) {
    for (const bool acts : {false, true}) {
      SCOPED_TRACE(fmt::format("request {}, acts {}", requests, acts));
      TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
      bench.fail_bus_after(requests, acts);
      EXPECT_THAT(failure_of(rig, bench, only_timing()), HasSubstr("timeout"));
    }
  }
}

TEST(Commission, StopsWhenAsked) {
  const Rig rig = written_rig(Shutter::global);
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
  CommissionOptions options = only_timing();
  int asked = 0;
  options.should_stop = [&asked] { return ++asked > 300; };
  EXPECT_THAT(failure_of(rig, bench, options), HasSubstr("the lights are off"));
}

TEST(Commission, SaysWhenNoLightIsSeen) {
  const Rig rig = written_rig(Shutter::global);
  SimTruth dark = truth_of({TimestampMeaning::end_frame, Shutter::global});
  for (int k = 0; k < 64; ++k) {
    dark.dim.emplace_back(k, 1e-6);
  }
  TwinBench bench(rig, dark);
  EXPECT_THAT(failure_of(rig, bench, only_timing()), HasSubstr("lens cap"));
}

TEST(Commission, KeepsWithinTheRigsPower) {
  Rig rig = written_rig(Shutter::global);
  rig.faces[0].max_power = Watts(20.0);  // four of 64 lights
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
  const CommissionResult r =
      commission(rig, bench.camera(), bench.lights(), only_timing(), bench.clock());
  EXPECT_LE(bench.lit_watts_peak(), 20.0);
  EXPECT_GT(bench.lit_watts_peak(), 0.0);
  EXPECT_NEAR(r.measured.controller->latch_us->value, 812.0, 100.0);
}

TEST(Commission, ACaptureRefusesACameraThatWasNotMeasured) {
  Rig rig = written_rig(Shutter::global);
  MeasuredRig measured;
  measured.cameras.emplace_back();
  measured.cameras[0].id = "main";
  measured.cameras[0].identity = "twin";
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
  for (const char* identity : {"twin", "another"}) {
    measured.cameras[0].identity = identity;
    rig.measured = std::make_shared<const MeasuredRig>(measured);
    const auto camera = require_measured_identity(bench.take_camera(), rig);
    const auto setup = camera->start(rig.cameras[0]);
    EXPECT_EQ(setup.has_value(), std::string(identity) == "twin");
    if (!setup) {
      EXPECT_EQ(setup.error().code, Errc::refused);
      EXPECT_THAT(setup.error().what, HasSubstr("stale"));
    }
  }
}

TEST(Commission, RefusesAControllerOfAnotherSize) {
  const Rig rig = written_rig(Shutter::global);
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
  Rig larger = rig;
  larger.faces[0].rows = 4;
  EXPECT_THAT(failure_of(larger, bench, only_timing()), HasSubstr("64 elements"));
}

}  // namespace
}  // namespace haarlight
