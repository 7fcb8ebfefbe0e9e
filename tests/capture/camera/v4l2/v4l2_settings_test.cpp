// SPDX-License-Identifier: Apache-2.0
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/camera/v4l2_camera.h"
#include "tests/capture/camera/v4l2/v4l2_rig.h"

/// @file
/// What a rig file can ask of a V4L2 camera beside its usual controls: 64 bits, a region of the
/// sensor, triggers; with drivers of both generations of calls.

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::in;
using testing::kTestHeight;
using testing::kTestWidth;
using testing::kTriggerMode;
using testing::kTriggerSource;
using ::testing::Not;
using testing::usual_camera;

constexpr std::uint32_t kTegraGain = 0x009a2009;
constexpr std::uint32_t kTegraExposure = 0x009a200a;

class V4l2Settings : public ::testing::Test {
 protected:
  Result<CameraSetup> start(shim::Camera camera) {
    machine_.unplug(0);
    machine_.plug(0, std::move(camera), "A1");
    return camera_.start(spec_);
  }
  [[nodiscard]] std::int64_t value(std::uint32_t id) const {
    return shim::control_value(machine_.node(0), id);
  }

  testing::V4l2Machine machine_;
  CameraSpec spec_ = machine_.spec(0);
  V4l2Camera camera_{machine_.paths()};
};

// ---- controls ----

/// As Nvidia's drivers for sensors offer them: everything in 64 bits, with ids of their own.
shim::Camera tegra_camera() {
  using C = shim::Control;
  shim::Camera camera = usual_camera();
  camera.controls = {
      C{.id = kTegraGain,
        .name = "Gain",
        .type = V4L2_CTRL_TYPE_INTEGER64,
        .min = 16,
        .max = 356,
        .value = 200},
      C{.id = kTegraExposure,
        .name = "Exposure",
        .type = V4L2_CTRL_TYPE_INTEGER64,
        .min = 28,
        .max = 10'000'000'000,
        .value = 33},
      C{.id = kTegraExposure + 1,
        .name = "Frame Rate",
        .type = V4L2_CTRL_TYPE_INTEGER64,
        .min = 2'000'000,
        .max = 60'000'000'000,
        .value = 30'000'000},
      C{.id = kTegraExposure + 2,
        .name = "Sensor Modes",
        .type = V4L2_CTRL_TYPE_INTEGER_MENU,
        .max = 0,
        .entries = {"1"}},
      C{.id = kTegraExposure + 3,
        .name = "EEPROM Data",
        .type = V4L2_CTRL_TYPE_STRING,
        .flags = V4L2_CTRL_FLAG_HAS_PAYLOAD | V4L2_CTRL_FLAG_READ_ONLY},
  };
  return camera;
}

TEST_F(V4l2Settings, ControlsOf64BitsAreSetAndReadBackInFull) {
  spec_.exposure_us = 8000.0;
  spec_.v4l2.exposure_unit_us = 1.0;
  spec_.v4l2.controls = {{"frame_rate", 50'000'000'000, ""}};
  const auto setup = start(tegra_camera());
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(value(kTegraExposure), 8000);
  EXPECT_EQ(value(kTegraGain), 16);  // the least, as with any gain that the rig file leaves out
  EXPECT_EQ(value(kTegraExposure + 1), 50'000'000'000);
  EXPECT_EQ(setup->exposure_us, 8000.0);
  const auto longer = camera_.set_exposure(5e9);  // beyond 32 bits
  ASSERT_TRUE(longer.has_value()) << longer.error().what;
  EXPECT_EQ(value(kTegraExposure), 5'000'000'000);
  EXPECT_EQ(*longer, 5e9);
  EXPECT_EQ(shim::calls()[VIDIOC_S_CTRL], 0U);
  // A change beyond the lower 32 bits is one too.
  shim::move_control(machine_.node(0), kTegraExposure + 1,
                     50'000'000'000 + (std::int64_t{1} << 32), true);
  const auto frame = camera_.next(in(2s));
  ASSERT_FALSE(frame.has_value());
  EXPECT_THAT(frame.error().what, HasSubstr("frame_rate changed by itself"));
}

TEST_F(V4l2Settings, OfWideRangesTheWholeIsKnown) {
  shim::Camera device = tegra_camera();
  device.controls[1].min = INT64_MIN;
  device.controls[1].max = INT64_MAX;
  device.controls[1].step = 3;
  spec_.v4l2.exposure_unit_us = 1.0;
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_NEAR(setup->exposure_us, 2000.0, 3.0);
}

TEST_F(V4l2Settings, ADriverWithTheOldCallsOnlyIsSetByThem) {
  shim::Camera device = usual_camera();
  device.has_ext_controls = false;
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_AUTO), 1);
  EXPECT_EQ(value(V4L2_CID_EXPOSURE_ABSOLUTE), 20);
  EXPECT_GT(shim::calls()[VIDIOC_S_CTRL], 5U);
  EXPECT_TRUE(camera_.next(in(2s)).has_value());
  shim::move_control(machine_.node(0), V4L2_CID_GAIN, 7, true);
  EXPECT_THAT(camera_.next(in(2s)).error().what, HasSubstr("gain changed by itself"));
}

TEST_F(V4l2Settings, WhatHasMoreThanOneValueIsListedAndNotSet) {
  spec_.v4l2.exposure_unit_us = 1.0;
  spec_.v4l2.controls = {{"eeprom_data", 1, ""}};
  const auto setup = start(tegra_camera());
  ASSERT_FALSE(setup.has_value());
  EXPECT_THAT(setup.error().what, HasSubstr("control eeprom_data cannot be set"));
  const std::string text = to_text(*describe_v4l2_camera(machine_.node(0), machine_.paths()));
  EXPECT_THAT(text, AllOf(HasSubstr("control eeprom_data: an array or a text"),
                          HasSubstr("control exposure = 33: 28 to 10000000000")));
}

// ---- a region of the sensor ----

shim::Camera sensor_camera() {
  shim::Camera camera = usual_camera();
  camera.sensor = shim::Region{0, 0, 640, 480};
  return camera;
}

TEST_F(V4l2Settings, ARegionIsSetAndReadBackWhateverTheDriversOrder) {
  spec_.v4l2.crop = {320, 100};
  for (const bool forgets : {false, true}) {
    shim::Camera device = sensor_camera();
    device.format_forgets_region = forgets;
    const auto setup = start(device);
    ASSERT_TRUE(setup.has_value()) << setup.error().what;
    const shim::Region region = shim::region(machine_.node(0));
    EXPECT_EQ(region.left, 320);
    EXPECT_EQ(region.top, 100);
    EXPECT_EQ(region.width, kTestWidth);
    EXPECT_EQ(region.height, kTestHeight);
    EXPECT_EQ(setup->width, kTestWidth);
    camera_.stop();
  }
}

TEST_F(V4l2Settings, ARegionThatIsRoundedOutsideOrNotOfferedIsRefusedWithTheHint) {
  spec_.v4l2.crop = {321, 100};
  shim::Camera device = sensor_camera();
  device.region_step = 8;
  auto setup = start(device);
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::refused);
  EXPECT_THAT(setup.error().what, AllOf(HasSubstr("10x6 from column 321, row 100"),
                                        HasSubstr("it set 10x6 from column 320, row 96")));
  spec_.v4l2.crop = {635, 100};
  setup = camera_.start(spec_);
  ASSERT_FALSE(setup.has_value());
  EXPECT_THAT(setup.error().what,
              HasSubstr("lies outside of the sensor, 640x480 from column 0, row 0"));
  spec_.v4l2.crop = {0, 0};
  setup = start(usual_camera());
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::unsupported);
  EXPECT_THAT(setup.error().what, HasSubstr("leave crop out"));
}

TEST_F(V4l2Settings, AnEarlierProgramsRegionIsNotKept) {
  spec_.frame_width = 640;
  spec_.frame_height = 480;
  machine_.plug(0, sensor_camera(), "A1");
  shim::set_region(machine_.node(0), {100, 50, 320, 240});
  const auto setup = camera_.start(spec_);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(shim::region(machine_.node(0)).left, 0);
  EXPECT_EQ(shim::region(machine_.node(0)).width, 640);
}

TEST_F(V4l2Settings, TheListTellsOfRegionsAndButtons) {
  shim::Camera device = sensor_camera();
  testing::add_trigger(device);
  machine_.plug(0, device, "A1");
  EXPECT_THAT(
      to_text(*describe_v4l2_camera(machine_.node(0), machine_.paths())),
      AllOf(HasSubstr("region 640x480 from column 0, row 0 of 640x480 from column 0, row 0"),
            HasSubstr("control trigger_software: a button; trigger.fire takes it")));
  machine_.plug(1, usual_camera());
  EXPECT_THAT(to_text(*describe_v4l2_camera(machine_.node(1), machine_.paths())),
              Not(HasSubstr("region")));
}

// ---- triggers ----

TEST_F(V4l2Settings, AFrameComesForEachTriggerAndNoOther) {
  shim::Camera device = usual_camera();
  testing::add_trigger(device);
  device.exposure_ns = 2'000'000;
  spec_.v4l2.trigger = testing::usual_trigger();
  ASSERT_TRUE(camera_.set_trigger(TriggerSource::software).has_value());
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(value(kTriggerMode), 1);
  EXPECT_EQ(value(kTriggerSource), 4);
  EXPECT_EQ(camera_.next(in(30ms)).error().code, Errc::timeout);
  for (std::uint64_t n = 0; n < 5; ++n) {
    ASSERT_TRUE(camera_.trigger().has_value());
    EXPECT_TRUE(camera_.trigger().has_value());  // while it is busy: nothing
    const auto frame = camera_.next(in(2s));
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    EXPECT_EQ(frame->info().sequence, n);
  }
  EXPECT_EQ(camera_.next(in(30ms)).error().code, Errc::timeout);
}

TEST_F(V4l2Settings, RunningFreelyAWaitingCameraIsLetGo) {
  shim::Camera device = usual_camera();
  testing::add_trigger(device);
  device.controls[device.controls.size() - 3].value = 1;  // left waiting by another program
  spec_.v4l2.trigger = testing::usual_trigger();
  ASSERT_TRUE(start(device).has_value());
  EXPECT_EQ(value(kTriggerMode), 0);
  EXPECT_TRUE(camera_.next(in(2s)).has_value());
  EXPECT_EQ(camera_.trigger().error().code, Errc::unsupported);
}

TEST_F(V4l2Settings, ItsTriggerInputIsChosenByItsOwnControls) {
  shim::Camera device = usual_camera();
  testing::add_trigger(device);
  device.controls[device.controls.size() - 2].value = 3;
  spec_.v4l2.trigger = testing::usual_trigger();
  ASSERT_TRUE(camera_.set_trigger(TriggerSource::line).has_value());
  ASSERT_TRUE(start(device).has_value());
  EXPECT_EQ(value(kTriggerMode), 1);
  EXPECT_EQ(value(kTriggerSource), 0);
}

TEST_F(V4l2Settings, ATriggerThatTheRigFileOrTheCameraLacksIsNamed) {
  machine_.plug(0, usual_camera(), "A1");
  ASSERT_TRUE(camera_.set_trigger(TriggerSource::software).has_value());
  auto setup = camera_.start(spec_);
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::unsupported);
  EXPECT_THAT(setup.error().what, HasSubstr("no trigger.software"));
  spec_.v4l2.trigger = testing::usual_trigger();
  setup = camera_.start(spec_);
  ASSERT_FALSE(setup.has_value());
  EXPECT_THAT(setup.error().what, HasSubstr("no control \"trigger_software\""));
  spec_.v4l2.trigger.fire = "power_line_frequency";
  spec_.v4l2.trigger.software = {{"gain", 3, ""}};
  spec_.v4l2.controls = {{"gain", 4, ""}};
  EXPECT_THAT(camera_.start(spec_).error().what, HasSubstr("set twice"));
  shim::Camera device = usual_camera();
  testing::add_trigger(device);
  spec_.v4l2.controls = {{"trigger_software", 1, ""}};
  EXPECT_THAT(start(device).error().what, HasSubstr("a button, for trigger.fire"));
}

TEST_F(V4l2Settings, AFaultOfTheTriggerIsAValue) {
  shim::Camera device = usual_camera();
  testing::add_trigger(device);
  spec_.v4l2.trigger = testing::usual_trigger();
  for (const int error : {EIO, ENODEV, EBUSY}) {
    ASSERT_TRUE(camera_.set_trigger(TriggerSource::software).has_value());
    ASSERT_TRUE(start(device).has_value());
    shim::fail_call(VIDIOC_S_EXT_CTRLS, 0, error);
    const auto fired = camera_.trigger();
    EXPECT_EQ(fired.has_value(), error == EBUSY);
    shim::reset_calls();
    camera_.stop();
    EXPECT_EQ(camera_.trigger().error().code, Errc::device_gone);
  }
}

}  // namespace
}  // namespace haarlight::capture
