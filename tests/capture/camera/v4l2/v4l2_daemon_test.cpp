// SPDX-License-Identifier: Apache-2.0
#include <cstring>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/camera/metadata_rows.h"
#include "capture/camera/v4l2_camera.h"
#include "capture/daemon/daemon.h"
#include "haarlight/core/error.h"
#include "tests/capture/camera/v4l2/v4l2_rig.h"
#include "tests/capture/daemon_bench.h"
#include "tests/capture/session_truth.h"

/// @file
/// The production daemon with the production V4L2 camera over the shim. The sensor truly looks
/// at the light: it writes the tag that was lit all through its exposure into its last rows.

namespace haarlight::capture {
namespace {

using testing::expect_true_session;
using namespace std::chrono_literals;

const std::string kPlan = "schema = 1\nname = \"quick\"\npatterns = \"one_at_a_time\"\n";

class V4l2Daemon : public testing::DaemonBench {
 protected:
  V4l2Daemon() {
    CameraSpec& camera = rig_.cameras[0];
    camera.kind = CameraKind::v4l2;
    camera.device = machine_.node(0);
    camera.format = "Y14 ";
    camera.exposure_delay_frames = 3;
    camera.fps = 120.0;
  }

  /// A camera of the rig's size that writes a noisy grey and the tag it saw.
  [[nodiscard]] shim::Camera looking_camera() const {
    const CameraSpec& spec = rig_.cameras[0];
    shim::Camera camera = testing::usual_camera();
    camera.offers = {{"Y14 ", {{spec.frame_width, spec.frame_height}}, {120}},
                     {"MJPG", {{spec.frame_width, spec.frame_height}}, {120}}};
    camera.period_ns = 8'333'333;
    camera.exposure_ns = 2'000'000;
    camera.read_ns = 2'500'000;
    camera.row_padding = 32;
    camera.fill = [light = light_, rows = spec.active_rows](shim::Filling& job) {
      const auto tag = light->tag_between(job.start_ns, job.end_ns);
      Image<std::uint16_t> words(job.height, job.width, 1);
      for (int y = 0; y < rows; ++y) {
        for (int x = 0; x < job.width; ++x) {
          const auto noise =
              static_cast<unsigned>(job.n * 31) + static_cast<unsigned>(7 * y + x);
          words(y, x) = static_cast<std::uint16_t>(256U + noise % 97U);
        }
      }
      const ImageView<std::uint16_t> metadata_rows(&words(rows, 0), job.height - rows,
                                                   job.width, 1);
      encode_metadata_rows(metadata_rows,
                           {.tag = tag.value_or(0), .is_mixed = !tag.has_value()}, 256, 12000);
      for (int y = 0; y < job.height; ++y) {
        const auto row = std::as_const(words).view().row(y);
        std::memcpy(job.bytes.data() + static_cast<std::size_t>(y) * job.stride, row.data(),
                    row.size_bytes());
      }
    };
    return camera;
  }

  Result<std::unique_ptr<Camera>> make_camera() override {
    return std::make_unique<V4l2Camera>(machine_.paths());
  }

  testing::V4l2Machine machine_;
};

TEST_F(V4l2Daemon, CapturesAPlanAndEveryFrameShowsItsOwnLight) {
  machine_.plug(0, looking_camera(), "A1");
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_TRUE(light_->is_dark());
}

TEST_F(V4l2Daemon, LightLeadsWithTheRigFilesTriggerControls) {
  shim::Camera camera = looking_camera();
  testing::add_trigger(camera);
  camera.trigger_delay_ns = 300'000;
  machine_.plug(0, camera, "A1");
  rig_.sync = SyncMode::light_leads;
  rig_.cameras[0].v4l2.trigger = testing::usual_trigger();
  rig_.cameras[0].exposure_delay_frames = 0;
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_GE(shim::n_fired(machine_.node(0)), 64U);  // every frame by a trigger of ours
  EXPECT_TRUE(light_->is_dark());
}

TEST_F(V4l2Daemon, LightLeadsWithoutTriggerControlsEndsTheRunWithTheHint) {
  machine_.plug(0, looking_camera(), "A1");
  rig_.sync = SyncMode::light_leads;
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.reason_text.find("no trigger.software") != std::string::npos;
  })) << daemon_->state().reason_text;
  EXPECT_TRUE(wait_for(Phase::idle));
}

TEST_F(V4l2Daemon, TheCableOutSuspendsWithinASecondAndTheRunGoesOnUnderAnotherNode) {
  machine_.plug(0, looking_camera(), "A1");
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5)) << daemon_->state().reason_text;
  machine_.unplug(0);
  EXPECT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::suspended; }));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  EXPECT_EQ(daemon_->state().reasons, kCameraLost);
  machine_.plug(0, looking_camera(), "B2");  // another one where it was: not taken
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.reason_text.find("serial A1 is not there") != std::string::npos;
  })) << daemon_->state().reason_text;
  machine_.plug(2, looking_camera(), "A1");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(V4l2Daemon, ABrokenStreamAndADriftingControlCostFramesAndNothingElse) {
  machine_.plug(0, looking_camera(), "A1");
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5)) << daemon_->state().reason_text;
  shim::break_stream(machine_.node(0));
  ASSERT_TRUE(wait_for_commits(15)) << daemon_->state().reason_text;
  shim::move_control(machine_.node(0), V4L2_CID_GAIN, 40, true);
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_EQ(shim::control_value(machine_.node(0), V4L2_CID_GAIN), 0);
}

TEST_F(V4l2Daemon, AFormatThatIsNotOfferedEndsTheRunWithTheList) {
  machine_.plug(0, looking_camera(), "A1");
  rig_.cameras[0].format = "Y16 ";
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.reason_text.find("it offers \"Y14 \"") != std::string::npos;
  })) << daemon_->state().reason_text;
  EXPECT_TRUE(wait_for(Phase::idle));
  EXPECT_TRUE(light_->is_dark());
}

TEST_F(V4l2Daemon, MotionJpegIsNotCaptured) {
  machine_.plug(0, looking_camera(), "A1");
  rig_.cameras[0].format = "MJPG";
  rig_.cameras[0].bits = 8;
  start();
  try {
    (void)daemon_->run(kPlan, "p.toml");
    FAIL() << "captures";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("for looking only"), std::string::npos);
  }
}

}  // namespace
}  // namespace haarlight::capture
