/// The daemon with its real drivers against the simulator's real servers, in one process:
/// Modbus over TCP and over a serial line, the camera over its socket, on the real clock.

#include <chrono>
#include <thread>

#include <gtest/gtest.h>

#include "capture/daemon.h"
#include "session/storage.h"
#include "sim/virtual_rig.h"
#include "tests/capture/session_truth.h"
#include "tests/sim/made_transport.h"

namespace haarlight {
namespace {

using namespace std::chrono_literals;
using testing::expect_true_session;

class WholeRig : public ::testing::Test {
 protected:
  WholeRig() : wanted_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    wanted_.http.port = 0;
    wanted_.storage.reserve_mb = 0.0;
    std::vector<float> brightness;
    brightness.reserve(static_cast<std::size_t>(wanted_.n_lights()));
    for (int k = 0; k < wanted_.n_lights(); ++k) {
      brightness.push_back(0.5F + 0.01F * static_cast<float>(k));
    }
    const CameraSpec& camera = wanted_.cameras.front();
    transports_.push_back(
        testing::flat_transport(folder_, camera.frame_width, camera.active_rows, brightness));
  }

  /// Runs one plan to its end.
  void capture(const FaultScript& faults, const std::function<void(Daemon&)>& meanwhile = {}) {
    rig_ = std::make_unique<VirtualRig>(
        wanted_, transports_,
        VirtualRigOptions{.faults = faults, .own_folder = folder_.path()});
    const Rig& rig = rig_->rig();
    Daemon daemon(DaemonConfig{
        .rig = rig,
        .sessions = folder_.path() / "sessions",
        .make_light = [&] { return make_light_array(rig.controller, rig.n_lights()); },
        .make_camera = [&] { return make_camera(rig.cameras.front()); },
        .storage = &storage_,
        .has_http = false});
    const auto deadline = std::chrono::steady_clock::now() + 60s;
    const auto wait_until = [&](auto predicate) {
      while (!predicate(daemon.state())) {
        if (std::chrono::steady_clock::now() > deadline) {
          return false;
        }
        std::this_thread::sleep_for(2ms);
      }
      return true;
    };
    ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::idle; }));
    const RunReceipt receipt =
        daemon.run("schema = 1\nname = \"whole\"\npatterns = \"one_at_a_time\"\n", "p");
    if (meanwhile) {
      ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.n_committed >= 10; }));
      meanwhile(daemon);
    }
    ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::done; }))
        << to_string(daemon.state().phase) << ": " << daemon.state().reason_text;
    counters_ = daemon.state().counters;
    expect_true_session(receipt.folder);
    EXPECT_TRUE(rig_->controller().lit().pattern->empty()) << "the lights are left on";
  }

  testing::TemporaryFolder folder_;
  Rig wanted_;
  std::vector<Transport> transports_;
  DiskStorage storage_;
  std::unique_ptr<VirtualRig> rig_;
  SequencerCounters counters_;
};

TEST_F(WholeRig, EveryLightIsCommittedOverModbusTcp) { capture({}); }

TEST_F(WholeRig, EveryLightIsCommittedOverASerialLine) {
  wanted_.controller.kind = ControllerKind::modbus_rtu;
  wanted_.controller.address = "/dev/none:115200";  // the virtual rig puts its own in
  capture({});
}

TEST_F(WholeRig, LateLostRepeatedStaleAndSwappedFramesChangeNothing) {
  FaultScript faults;
  faults.frames = {.late_share = 0.05,
                   .late_ms = 20.0,
                   .drop_share = 0.05,
                   .duplicate_share = 0.05,
                   .stale_share = 0.05,
                   .swap_share = 0.05,
                   .jitter_us = 50.0};
  capture(faults);
  EXPECT_GT(counters_.sequence_gaps, 0U);
  EXPECT_GT(counters_.duplicates, 0U);
  EXPECT_GT(counters_.frames_out_of_order, 0U);
}

TEST_F(WholeRig, AControllerThatRestartsIsFoundAgain) {
  capture({}, [this](Daemon&) { rig_->controller().restart(200ms); });
  EXPECT_EQ(counters_.controller_reboots, 1U);
}

TEST_F(WholeRig, AnOpenInterlockSuspendsTheRunUntilItCloses) {
  capture({}, [this](Daemon& daemon) {
    rig_->controller().set_interlock_open(true);
    const auto deadline = std::chrono::steady_clock::now() + 10s;
    while (daemon.state().phase != Phase::suspended &&
           std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(1ms);
    }
    EXPECT_EQ(daemon.state().reasons, kHeldBack) << daemon.state().reason_text;
    rig_->controller().set_interlock_open(false);
  });
  EXPECT_GE(counters_.suspensions, 1U);
}

TEST_F(WholeRig, ACameraThatIsCutOffIsFoundAgain) {
  capture({}, [this](Daemon&) { rig_->camera(0).disconnect_client(); });
  EXPECT_GE(counters_.camera_faults, 1U);
}

}  // namespace
}  // namespace haarlight
