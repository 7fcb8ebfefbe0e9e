// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission.h"

#include <cstdlib>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/camera/measured_camera.h"
#include "haarlight/core/error.h"
#include "tests/capture/commission/commission_truth.h"
#include "tests/capture/twin_bench.h"

/// @file
/// What a commissioning does when things are not as they should be; commission_cases_test.cpp
/// has what it measures.

namespace haarlight::capture {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::truth_of;
using testing::TwinBench;
using testing::written_rig;

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
  for (const int requests : {0, 60, 400}) {
    for (const bool acts : {false, true}) {
      SCOPED_TRACE(fmt::format("request {}, acts {}", requests, acts));
      TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
      bench.fail_bus_after(requests, acts);
      EXPECT_THAT(failure_of(rig, bench, only_timing()), HasSubstr("timeout"));
    }
  }
}

TEST(Commission, StopsOnRequest) {
  const Rig rig = written_rig(Shutter::global);
  TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, Shutter::global}));
  CommissionOptions options = only_timing();
  int requested = 0;
  options.should_stop = [&requested] { return ++requested > 300; };
  EXPECT_THAT(failure_of(rig, bench, options), HasSubstr("the lights are off"));
}

TEST(Commission, SaysWhenNoLightIsSeen) {
  const Rig rig = written_rig(Shutter::global);
  sim::SimTruth dark = truth_of({TimestampMeaning::end_frame, Shutter::global});
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

TEST(Commission, SaysWhenExposuresAreNotWhatTheCameraSays) {
  struct Case {
    Shutter shutter;
    double factor;
    const char* says;
  };
  for (const Case& c :
       {Case{Shutter::global, 0.1, "far shorter than the camera says"},
        Case{Shutter::global, 0.95, "lasts 0.9"}, Case{Shutter::global, 10.0, "lasts 10.0"},
        Case{Shutter::rolling, 1.2, "lasts 1."}}) {
    SCOPED_TRACE(fmt::format("factor {}, {}", c.factor, to_string(c.shutter)));
    const Rig rig = written_rig(c.shutter);
    TwinBench bench(rig, truth_of({TimestampMeaning::end_frame, c.shutter}));
    bench.stretch_exposures(c.factor);
    const std::string problem = failure_of(rig, bench, only_timing());
    EXPECT_THAT(problem, HasSubstr(c.says));
    EXPECT_THAT(problem, HasSubstr("exposure_unit_us"));
    if (const std::size_t at = problem.find("lasts "); at != std::string::npos) {
      EXPECT_NEAR(std::atof(problem.c_str() + at + 6), c.factor, 0.015 * c.factor);
    }
  }
}

/// Under a diffuser every light fills the picture alike: a swap would not be seen, and that is
/// said with the lights it may be.
TEST(Commission, SaysWhichLightsWiringItCannotSee) {
  const Rig rig = written_rig(Shutter::global);
  sim::SimTruth truth = truth_of({TimestampMeaning::start_readout, Shutter::global});
  truth.dead.clear();
  truth.dim.clear();
  const testing::TemporaryFolder folder;
  sim::TransportData data;
  data.width = rig.cameras[0].frame_width;
  data.height = rig.cameras[0].active_rows;
  data.n_lights = rig.n_lights();
  data.key = std::string(32, 'a');
  data.seconds = 1.0;
  const std::vector<float> planes(
      static_cast<std::size_t>(data.width * data.height * data.n_lights), 1.0F);
  data.planes = planes;
  sim::write_transport(folder / "transport.bin", data);
  TwinBench bench(rig, truth, 1, 0.0, sim::Transport::open(folder / "transport.bin"));
  const CommissionResult r = commission(rig, bench.camera(), bench.lights(), {}, bench.clock());
  EXPECT_FALSE(r.survey->can_see_wiring);
  EXPECT_THAT(r.faults, ::testing::IsEmpty());
  EXPECT_THAT(r.notes, ::testing::Contains(HasSubstr(
                           "whether the cables of lights 0 to 63 are right stays open")));
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
}  // namespace haarlight::capture
