// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/v4l2_camera.h"

#include <cstring>
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/camera/grey_jpeg.h"
#include "capture/camera/pixel_unpack.h"
#include "tests/capture/camera/v4l2/v4l2_rig.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::in;
using testing::kTestHeight;
using testing::kTestWidth;
using testing::usual_camera;

/// The word that a counting camera puts at (y, x) of its n-th frame.
std::uint16_t counted(std::uint64_t n, int y, int x) {
  return static_cast<std::uint16_t>(1000 * (n + 1) + 100 * static_cast<std::uint64_t>(y) +
                                    static_cast<std::uint64_t>(x));
}

void fill_counted(shim::Filling& job) {
  for (int y = 0; y < job.height; ++y) {
    for (int x = 0; x < job.width; ++x) {
      const std::uint16_t word = counted(job.n, y, x);
      std::memcpy(job.bytes.data() + static_cast<std::size_t>(y) * job.stride +
                      static_cast<std::size_t>(x) * 2,
                  &word, 2);
    }
  }
}

class V4l2CameraTest : public ::testing::Test {
 protected:
  /// Plugs a camera as video0 and starts it.
  Result<CameraSetup> start(shim::Camera camera, const std::string& serial = "A1") {
    machine_.plug(0, std::move(camera), serial);
    return camera_.start(spec_);
  }
  Result<Frame> next() { return camera_.next(in(2s)); }

  testing::V4l2Machine machine_;
  CameraSpec spec_ = machine_.spec(0);
  V4l2Camera camera_{machine_.paths()};
};

// ---- frames ----

class V4l2Layout : public V4l2CameraTest,
                   public ::testing::WithParamInterface<std::pair<bool, std::size_t>> {};

TEST_P(V4l2Layout, WordsTimestampAndCountArriveWhateverThePlanesAndThePadding) {
  shim::Camera device = usual_camera();
  device.is_multiplanar = GetParam().first;
  device.row_padding = GetParam().second;
  device.fill = fill_counted;
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(setup->width, kTestWidth);
  EXPECT_EQ(setup->fps, 60.0);
  EXPECT_EQ(setup->identity, "Shim Camera, serial A1");
  std::int64_t last_ns = 0;
  for (std::uint64_t n = 0; n < 10; ++n) {  // more than there are buffers
    const auto frame = next();
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    EXPECT_EQ(frame->info().sequence, n);
    EXPECT_EQ(frame->info().flags, kFrameMonotonic);
    EXPECT_GT(frame->info().timestamp_ns, last_ns);
    last_ns = frame->info().timestamp_ns;
    ASSERT_EQ(frame->pixels().height(), kTestHeight);
    for (int y = 0; y < kTestHeight; ++y) {
      for (int x = 0; x < kTestWidth; ++x) {
        ASSERT_EQ(frame->pixels()(y, x), counted(n, y, x));
      }
    }
  }
}
INSTANTIATE_TEST_SUITE_P(PlanesAndPadding, V4l2Layout,
                         ::testing::Values(std::pair{false, 0}, std::pair{false, 44},
                                           std::pair{true, 0}, std::pair{true, 12}));

TEST_F(V4l2CameraTest, TheDriversNumberOfBuffersIsTaken) {
  shim::Camera device = usual_camera();
  device.least_buffers = 9;
  ASSERT_TRUE(start(device).has_value());
  EXPECT_EQ(shim::calls()[VIDIOC_QUERYBUF], 9U);
  for (int i = 0; i < 20; ++i) {
    ASSERT_TRUE(next().has_value());
  }
}

TEST_F(V4l2CameraTest, FlagsShortBuffersAndForeignClocksAreInTheEvidence) {
  shim::Camera device = usual_camera();
  device.fill = [](shim::Filling& job) {
    switch (job.n) {
      case 0:
        job.flags |= V4L2_BUF_FLAG_ERROR;
        break;
      case 1:
        job.bytes_used -= 1;
        break;
      case 2:
        job.flags = V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN;
        break;
      case 3:
        job.flags |= V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
        break;
      case 4:
        job.timestamp_ns += 5'000'000'000;
        break;
      case 5:
        job.sequence = 2;
        break;
      default:
        break;
    }
  };
  ASSERT_TRUE(start(device).has_value());
  std::vector<std::uint32_t> flags;
  std::vector<bool> has_pixels;
  for (int i = 0; i < 7; ++i) {
    const auto frame = next();
    ASSERT_TRUE(frame.has_value()) << frame.error().what;
    flags.push_back(frame->info().flags);
    has_pixels.push_back(!frame->pixels().is_empty());
  }
  EXPECT_THAT(flags, ElementsAre(kFrameMonotonic | kFrameError, kFrameMonotonic | kFrameShort,
                                 0U, kFrameMonotonic | kFrameTimestampedAtStart,
                                 kFrameMonotonic | kFrameTimestampJump | kFrameError,
                                 kFrameMonotonic | kFrameSequenceRestart | kFrameError,
                                 kFrameMonotonic));
  EXPECT_THAT(has_pixels, ElementsAre(true, false, true, true, true, true, true));
}

TEST_F(V4l2CameraTest, GapsStayAndTheWrapOf32BitsIsCountedOver) {
  shim::Camera device = usual_camera();
  device.first_sequence = 0xFFFF'FFFE;
  device.fill = [](shim::Filling& job) { job.sequence += job.n > 2 ? 10 : 0; };
  ASSERT_TRUE(start(device).has_value());
  std::vector<std::uint64_t> counts;
  for (int i = 0; i < 4; ++i) {
    counts.push_back(next()->info().sequence);
  }
  EXPECT_THAT(counts, ElementsAre(0xFFFF'FFFEU, 0xFFFF'FFFFU, 0x1'0000'0000U, 0x1'0000'000BU));
}

TEST_F(V4l2CameraTest, AFrameOutlivesTheCameraAndItsDevice) {
  shim::Camera device = usual_camera();
  device.fill = fill_counted;
  std::optional<Frame> frame;
  machine_.plug(0, device);
  {
    V4l2Camera camera(machine_.paths());
    ASSERT_TRUE(camera.start(spec_).has_value());
    frame.emplace(*camera.next(in(2s)));
  }
  machine_.unplug(0);
  EXPECT_EQ(frame->pixels()(3, 4), counted(0, 3, 4));
}

TEST_F(V4l2CameraTest, HeldFramesCostMemoryAndTheRestIsAGapThatIsSeen) {
  const auto setup = start(usual_camera());
  ASSERT_TRUE(setup.has_value());
  std::vector<Frame> held;
  for (int i = 0; i < setup->n_buffers; ++i) {
    held.push_back(*next());
  }
  EXPECT_EQ(camera_.next(in(20ms)).error().code, Errc::timeout);
  EXPECT_GT(camera_.counters().pool_exhausted, 0U);
  const std::uint64_t last = held.back().info().sequence;
  held.clear();
  EXPECT_GT(next()->info().sequence, last + 1);
}

TEST_F(V4l2CameraTest, SilenceIsATimeoutAtTheDeadline) {
  ASSERT_TRUE(start(usual_camera()).has_value());
  shim::set_silent(machine_.node(0), true);
  const auto begin = std::chrono::steady_clock::now();
  EXPECT_EQ(camera_.next(begin + 50ms).error().code, Errc::timeout);
  EXPECT_GE(std::chrono::steady_clock::now() - begin, 50ms);
  shim::set_silent(machine_.node(0), false);
  EXPECT_TRUE(next().has_value());
}

TEST_F(V4l2CameraTest, SamplesInTheHighBitsAreRefusedWithTheHint) {
  shim::Camera device = usual_camera();
  device.offers = {{"Y12 ", {{kTestWidth, kTestHeight}}, {60}}};
  device.fill = [](shim::Filling& job) { job.bytes[1] = std::byte{0x80}; };
  spec_.format = "Y12 ";
  spec_.bits = 12;
  ASSERT_TRUE(start(device).has_value());
  const auto frame = next();
  ASSERT_FALSE(frame.has_value());
  EXPECT_EQ(frame.error().code, Errc::unsupported);
  EXPECT_THAT(frame.error().what, HasSubstr("high bits"));
}

TEST_F(V4l2CameraTest, YuyvIsForDisplayAndItsGreyIsTaken) {
  shim::Camera device = usual_camera();
  device.offers = {{"YUYV", {{kTestWidth, kTestHeight}}, {60}}};
  device.fill = [](shim::Filling& job) {
    for (std::size_t i = 0; i < job.bytes.size(); ++i) {
      job.bytes[i] = i % 2 == 0 ? static_cast<std::byte>(i / 2) : std::byte{0x80};
    }
  };
  spec_.format = "YUYV";
  spec_.bits = 8;
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(setup->use, PixelUse::display);
  EXPECT_EQ(next()->pixels()(1, 2), kTestWidth + 2);
}

TEST_F(V4l2CameraTest, MotionJpegIsForPreviewAndADamagedPictureHasNoPixels) {
  Image<std::uint8_t> grey(kTestHeight, kTestWidth, 1);
  std::fill(grey.pixels().begin(), grey.pixels().end(), std::uint8_t{200});
  const std::string jpeg = encode_grey_jpeg(std::as_const(grey).view());
  shim::Camera device = usual_camera();
  device.offers = {{"MJPG", {{kTestWidth, kTestHeight}}, {60}}};
  device.bits_per_sample = 256;
  device.fill = [&jpeg](shim::Filling& job) {
    ASSERT_LE(jpeg.size(), job.bytes.size());
    std::memcpy(job.bytes.data(), jpeg.data(), jpeg.size());
    job.bytes_used = job.n == 0 ? jpeg.size() : jpeg.size() / 2;
  };
  spec_.format = "MJPG";
  spec_.bits = 8;
  const auto setup = start(device);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(setup->use, PixelUse::preview);
  EXPECT_EQ(next()->pixels()(2, 2), 200);
  const auto damaged = next();
  EXPECT_TRUE(damaged->pixels().is_empty());
  EXPECT_NE(damaged->info().flags & kFrameShort, 0U);
}

// ---- what the device does not offer ----

TEST_F(V4l2CameraTest, AFormatSizeOrRateThatIsNotOfferedListsWhatIs) {
  machine_.plug(0, usual_camera());
  const auto refusal = [&](auto change) {
    CameraSpec spec = spec_;
    change(spec);
    const auto setup = camera_.start(spec);
    EXPECT_FALSE(setup.has_value());
    EXPECT_EQ(setup.error().code, Errc::unsupported);
    EXPECT_THAT(setup.error().what,
                AllOf(HasSubstr("\"Y16 \" 10x6 (30, 60 fps), 640x480 (30, 60 fps)"),
                      HasSubstr("\"GREY\" 10x6 (30 fps)")));
    return setup.error().what;
  };
  EXPECT_THAT(refusal([](CameraSpec& s) { s.format = "Y12 "; }),
              HasSubstr("it would set \"Y16 \" 10x6"));
  EXPECT_THAT(refusal([](CameraSpec& s) { s.frame_width = 12; }), HasSubstr("12x6"));
  EXPECT_THAT(refusal([](CameraSpec& s) { s.fps = 50.0; }), HasSubstr("it would give 60 fps"));
  EXPECT_TRUE(camera_.start(spec_).has_value());
}

TEST_F(V4l2CameraTest, ANodeForSomethingElseAndOneInUseAreNamed) {
  shim::Camera other = usual_camera();
  other.is_capture = false;
  machine_.plug(0, other);
  EXPECT_EQ(camera_.start(spec_).error().code, Errc::unsupported);
  machine_.plug(1, usual_camera());
  V4l2Camera first(machine_.paths());
  ASSERT_TRUE(first.start(machine_.spec(1)).has_value());
  EXPECT_EQ(camera_.start(machine_.spec(1)).error().code, Errc::device_busy);
}

TEST_F(V4l2CameraTest, NoBandwidthOnTheBusIsNotCalledAFullDisk) {
  shim::fail_call(VIDIOC_STREAMON, 0, ENOSPC);
  const auto setup = start(usual_camera());
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::device_busy);
  EXPECT_THAT(setup.error().what, HasSubstr("USB bandwidth"));
}

// ---- controls ----

TEST_F(V4l2CameraTest, ModesAreSetFirstThenExposureGainAndTheRestAndReadBack) {
  spec_.v4l2.controls = {{"focus_absolute", 15, ""}, {"power_line_frequency", 0, "60 Hz"}};
  const auto setup = start(usual_camera());
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_THAT(shim::controls_set(machine_.node(0)),
              ElementsAre(V4L2_CID_EXPOSURE_AUTO, V4L2_CID_EXPOSURE_AUTO_PRIORITY,
                          V4L2_CID_AUTO_WHITE_BALANCE, V4L2_CID_FOCUS_AUTO,
                          V4L2_CID_POWER_LINE_FREQUENCY, V4L2_CID_EXPOSURE_ABSOLUTE,
                          V4L2_CID_GAIN, V4L2_CID_FOCUS_ABSOLUTE));
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_EXPOSURE_AUTO), 1);
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_EXPOSURE_ABSOLUTE), 20);
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_GAIN), 0);
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_POWER_LINE_FREQUENCY), 2);
  EXPECT_EQ(setup->exposure_us, 2000.0);
}

TEST_F(V4l2CameraTest, NamesOfOlderKernelsAreKnown) {
  spec_.v4l2.controls = {{"focus_auto", 0, ""}, {"exposure_auto", 0, "manual mode"}};
  EXPECT_TRUE(start(usual_camera()).has_value());
}

TEST_F(V4l2CameraTest, WrongNamesEntriesAndValuesSayWhatThereIs) {
  machine_.plug(0, usual_camera());
  const auto refusal = [&](const ControlSetting& setting) {
    CameraSpec spec = spec_;
    spec.v4l2.controls = {setting};
    const auto setup = camera_.start(spec);
    EXPECT_FALSE(setup.has_value());
    EXPECT_EQ(setup.error().code, Errc::unsupported);
    return setup ? std::string() : setup.error().what;
  };
  EXPECT_THAT(refusal({"gian", 3, ""}), HasSubstr("did you mean gain?"));
  EXPECT_THAT(refusal({"gain", 300, ""}), HasSubstr("it takes 0 to 255"));
  EXPECT_THAT(refusal({"power_line_frequency", 0, "70 Hz"}), HasSubstr("1 \"50 Hz\""));
  EXPECT_THAT(refusal({"auto_exposure", 2, ""}), HasSubstr("1 \"Manual Mode\""));
  EXPECT_THAT(refusal({"exposure_time_absolute", 20, ""}), HasSubstr("exposure_us"));
}

TEST_F(V4l2CameraTest, AControlThatTakesAnotherValueIsRefused) {
  shim::Camera device = usual_camera();
  device.controls[1].keeps = false;  // gain
  const auto setup = start(device);
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::refused);
  EXPECT_THAT(setup.error().what, HasSubstr("control gain: requested 0, it set 64"));
}

TEST_F(V4l2CameraTest, ACameraThatCannotExposeByHandIsRefused) {
  shim::Camera device = usual_camera();
  device.controls[3].entries[1] = "";
  EXPECT_THAT(start(device).error().what, HasSubstr("cannot expose by hand"));
}

TEST_F(V4l2CameraTest, ControlsThatTheStreamSetsAnewAreSetAgain) {
  shim::Camera device = usual_camera();
  device.set_at_stream_on = {{V4L2_CID_GAIN, 99}};
  ASSERT_TRUE(start(device).has_value());
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_GAIN), 0);
  EXPECT_TRUE(next().has_value());
}

TEST_F(V4l2CameraTest, AControlThatMovesIsToldBeforeTheNextFrame) {
  ASSERT_TRUE(start(usual_camera()).has_value());
  ASSERT_TRUE(next().has_value());
  shim::move_control(machine_.node(0), V4L2_CID_GAIN, 7, true);
  const auto frame = next();
  ASSERT_FALSE(frame.has_value());
  EXPECT_EQ(frame.error().code, Errc::io);
  EXPECT_THAT(frame.error().what, HasSubstr("gain changed by itself from 0 to 7"));
  EXPECT_TRUE(camera_.start(spec_).has_value());
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_GAIN), 0);
}

TEST_F(V4l2CameraTest, AControlThatMovesUntoldIsFoundByReadingItBack) {
  shim::Camera device = usual_camera();
  device.has_events = false;
  ASSERT_TRUE(start(device).has_value());
  shim::move_control(machine_.node(0), V4L2_CID_EXPOSURE_ABSOLUTE, 21, false);
  std::optional<Fault> fault;
  const auto end = in(5s);
  while (!fault && std::chrono::steady_clock::now() < end) {
    const auto frame = next();
    if (!frame) {
      fault = frame.error();
    }
  }
  ASSERT_TRUE(fault.has_value());
  EXPECT_THAT(fault->what, HasSubstr("changed by itself from 20 to 21"));
}

TEST_F(V4l2CameraTest, AnotherExposureIsUnknownForAsManyFramesAsTheRigSays) {
  spec_.exposure_delay_frames = 1;
  ASSERT_TRUE(start(usual_camera()).has_value());
  const auto exposures = [&](int n) {
    std::vector<double> list;
    for (int i = 0; i < n; ++i) {
      list.push_back(next()->info().exposure_us);
    }
    return list;
  };
  EXPECT_THAT(exposures(4), ElementsAre(0.0, 0.0, 2000.0, 2000.0));
  const auto set = camera_.set_exposure(5049.0);
  ASSERT_TRUE(set.has_value());
  EXPECT_EQ(*set, 5000.0);  // in steps of 100 us
  EXPECT_THAT(exposures(4), ElementsAre(0.0, 0.0, 5000.0, 5000.0));
}

TEST_F(V4l2CameraTest, AFixedExposureIsTakenFromTheRigFileAndNotChanged) {
  shim::Camera device = usual_camera();
  device.controls.clear();
  EXPECT_THAT(start(device).error().what, HasSubstr("exposure_control = \"none\""));
  spec_.v4l2.exposure_control = "none";
  ASSERT_TRUE(camera_.start(spec_).has_value());
  EXPECT_EQ(next()->info().exposure_us, 2000.0);
  EXPECT_TRUE(camera_.set_exposure(2000.0).has_value());
  EXPECT_EQ(camera_.set_exposure(3000.0).error().code, Errc::unsupported);
}

TEST_F(V4l2CameraTest, AnExposureInRowsNeedsItsUnit) {
  shim::Camera device = usual_camera();
  device.controls = {{.id = V4L2_CID_EXPOSURE, .name = "Exposure", .min = 4, .max = 4000}};
  EXPECT_THAT(start(device).error().what, HasSubstr("exposure_unit_us"));
  spec_.v4l2.exposure_unit_us = 14.8;
  const auto setup = camera_.start(spec_);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_EXPOSURE), 135);
  EXPECT_DOUBLE_EQ(setup->exposure_us, 135 * 14.8);
}

TEST_F(V4l2CameraTest, GainInDecibelsNeedsItsUnitToo) {
  spec_.gain_db = 6.0;
  EXPECT_THAT(start(usual_camera()).error().what, HasSubstr("gain_unit_db"));
  spec_.v4l2.gain_unit_db = 0.1;
  const auto setup = camera_.start(spec_);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_GAIN), 60);
  EXPECT_DOUBLE_EQ(setup->gain_db, 6.0);
}

// ---- faults of the stream, loss and return ----

TEST_F(V4l2CameraTest, ABrokenStreamIsBegunAnewAndTheCountShowsAGap) {
  ASSERT_TRUE(start(usual_camera()).has_value());
  const std::uint64_t before = next()->info().sequence;
  shim::break_stream(machine_.node(0));
  const auto frame = next();
  ASSERT_TRUE(frame.has_value()) << frame.error().what;
  EXPECT_GT(frame->info().sequence, before + 1);
  EXPECT_EQ(camera_.counters().io_errors, 1U);
  EXPECT_EQ(camera_.counters().restarts, 1U);
}

TEST_F(V4l2CameraTest, AStreamThatStaysBrokenIsAFaultAndANewStartMendsIt) {
  ASSERT_TRUE(start(usual_camera()).has_value());
  shim::fail_call(VIDIOC_DQBUF, 0, EIO, 4);
  const auto frame = next();
  ASSERT_FALSE(frame.has_value());
  EXPECT_EQ(frame.error().code, Errc::io);
  EXPECT_THAT(frame.error().what, HasSubstr("streaming anew 3 times"));
  ASSERT_TRUE(camera_.start(spec_).has_value());
  EXPECT_TRUE(next().has_value());
  EXPECT_EQ(camera_.counters().reopenings, 1U);
}

TEST_F(V4l2CameraTest, TheSameCameraIsFoundUnderAnotherNodeByItsSerialNumber) {
  ASSERT_TRUE(start(usual_camera(), "A1").has_value());
  machine_.unplug(0);
  EXPECT_EQ(next().error().code, Errc::device_gone);
  EXPECT_EQ(shim::n_open(), 0U);  // closed at once: the kernel can give the node away
  EXPECT_EQ(camera_.start(spec_).error().code, Errc::device_gone);
  machine_.plug(0, usual_camera(), "B2");  // another one where it was
  const auto other = camera_.start(spec_);
  ASSERT_FALSE(other.has_value());
  EXPECT_EQ(other.error().code, Errc::device_gone);
  EXPECT_THAT(other.error().what, HasSubstr("Shim Camera, serial A1 is not there"));
  machine_.plug(3, usual_camera(), "A1");
  const auto setup = camera_.start(spec_);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(setup->identity, "Shim Camera, serial A1");
  EXPECT_TRUE(next().has_value());
}

TEST_F(V4l2CameraTest, WithoutASerialNumberThePlugCounts) {
  ASSERT_TRUE(start(usual_camera(), "").has_value());
  machine_.unplug(0);
  shim::Camera elsewhere = usual_camera();
  elsewhere.bus_info = "usb-shim-7";
  machine_.plug(1, elsewhere);
  EXPECT_EQ(camera_.start(spec_).error().code, Errc::device_gone);
  machine_.plug(2, usual_camera());
  EXPECT_TRUE(camera_.start(spec_).has_value());
}

TEST_F(V4l2CameraTest, ASerialNumberOfTheRigFileFindsTheCameraTheFirstTime) {
  machine_.plug(0, usual_camera(), "B2");
  machine_.plug(4, usual_camera(), "A1");
  spec_.v4l2.serial = "A1";
  EXPECT_EQ(camera_.start(spec_)->identity, "Shim Camera, serial A1");
  spec_.v4l2.serial = "C3";
  V4l2Camera other(machine_.paths());
  EXPECT_THAT(
      other.start(spec_).error().what,
      AllOf(HasSubstr("serial number C3"), HasSubstr("video4 is Shim Camera, serial A1")));
}

TEST_F(V4l2CameraTest, ALinkByIdIsFollowedAndASecondNodeOfTheSameCameraIsAnother) {
  shim::Camera infrared = usual_camera();
  machine_.plug(0, usual_camera(), "A1", 0);
  machine_.plug(1, infrared, "A1", 2);
  machine_.link(1, "usb-Shim_A1-video-index2");
  spec_.device = machine_.link_path("usb-Shim_A1-video-index2");
  const auto setup = camera_.start(spec_);
  ASSERT_TRUE(setup.has_value()) << setup.error().what;
  EXPECT_EQ(setup->identity, "Shim Camera, serial A1, its node 2");
  machine_.unplug(1);
  EXPECT_EQ(next().error().code, Errc::device_gone);
  EXPECT_EQ(camera_.start(spec_).error().code, Errc::device_gone);  // not its first node
}

TEST_F(V4l2CameraTest, TheListNamesCamerasOnlyWithLinksFormatsAndControls) {
  shim::Camera metadata = usual_camera();
  metadata.is_capture = false;
  machine_.plug(0, usual_camera(), "A1");
  machine_.plug(1, metadata, "A1", 1);
  machine_.link(0, "usb-Shim_A1-video-index0");
  const auto cameras = list_v4l2_cameras(machine_.paths());
  ASSERT_EQ(cameras.size(), 1U);
  EXPECT_EQ(cameras[0].identity.serial, "A1");
  EXPECT_EQ(cameras[0].links.size(), 1U);
  const std::string text = to_text(cameras[0]);
  EXPECT_THAT(text, HasSubstr("format \"GREY\" GREY: linear; 10x6 (30 fps)"));
  EXPECT_THAT(text, HasSubstr("control power_line_frequency = 1: 0 \"Disabled\", 1 \"50 Hz\""));
  EXPECT_THAT(text, HasSubstr("control focus_absolute = 0: 0 to 250 in steps of 5"));
}

TEST(V4l2Names, AControlIsCalledAsV4l2CtlCallsIt) {
  EXPECT_EQ(control_key("White Balance, Automatic"), "white_balance_automatic");
  EXPECT_EQ(control_key("Exposure (Absolute)"), "exposure_absolute");
  EXPECT_EQ(control_key("Gain"), "gain");
}

TEST(V4l2Paths, AMachineWithoutCamerasSaysSo) {
  const testing::V4l2Machine machine;
  V4l2Camera camera(machine.paths());
  const auto setup = camera.start(machine.spec(0));
  ASSERT_FALSE(setup.has_value());
  EXPECT_EQ(setup.error().code, Errc::device_gone);
  EXPECT_THAT(setup.error().what, HasSubstr("this machine has no camera"));
  EXPECT_TRUE(list_v4l2_cameras(machine.paths()).empty());
}

}  // namespace
}  // namespace haarlight::capture
