// SPDX-License-Identifier: Apache-2.0
/// A finished session goes through the sequencer again, with its own timestamps: an old capture
/// can be validated by the present rules.

#include <thread>

#include <gtest/gtest.h>

#include "capture/camera/fake_camera.h"
#include "capture/camera/replay_camera.h"
#include "capture/daemon/daemon.h"
#include "capture/sequencer/sequencer.h"
#include "firmware_iface/fake_light_array.h"
#include "haarlight/core/files.h"
#include "session/storage.h"
#include "tests/temporary_folder.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;

/// A session of eight lights, captured with fake devices on the real clock.
std::filesystem::path capture_session(const std::filesystem::path& folder, Rig& rig) {
  rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  rig.storage.reserve_mb = 0.0;
  session::DiskStorage storage;
  auto light = std::make_shared<firmware_iface::FakeLight>();
  auto hands = std::make_shared<FakeCameraHands>();
  Daemon daemon({.rig = rig,
                 .sessions = folder,
                 .make_light = [&]() -> Result<std::unique_ptr<firmware_iface::LightArray>> {
                   return std::make_unique<firmware_iface::FakeLightArray>(light);
                 },
                 .make_camera = [&]() -> Result<std::unique_ptr<Camera>> {
                   return std::make_unique<FakeCamera>(light, hands);
                 },
                 .storage = &storage,
                 .has_http = false});
  const auto limit = std::chrono::steady_clock::now() + 20s;
  while (daemon.state().phase != Phase::idle && std::chrono::steady_clock::now() < limit) {
    std::this_thread::sleep_for(1ms);
  }
  const RunReceipt receipt = daemon.run(
      "schema = 1\nname = \"p\"\npatterns = \"one_at_a_time\"\nlights = [0,1,2,3,4,5,6,7]\n",
      "p");
  while (daemon.state().phase != Phase::done && std::chrono::steady_clock::now() < limit) {
    std::this_thread::sleep_for(1ms);
  }
  return receipt.folder;
}

/// Feeds the recorded latches, frames and confirmations; counts what would be committed.
int replay(ReplayCamera& camera, const Rig& rig, const Plan& plan, std::int64_t delay_ns) {
  SequencerState state;
  std::vector<Action> actions;
  const auto send = [&](std::int64_t t_ns, EventBody body) {
    StepResult result = step(std::move(state), TimedEvent{t_ns, std::move(body)});
    state = std::move(result.state);
    actions = std::move(result.actions);
  };
  send(0, event::Booted{});
  send(0, event::Recovered{});
  send(0, event::Run{sequencer_plan(rig, plan), std::vector<bool>(plan.shots.size(), false),
                     std::vector<int>(plan.shots.size(), 0)});
  send(0, event::LightConnected{state.job, 1});
  send(0, event::CameraStarted{state.stream, plan.shots.front().exposure_us, 8});
  // The session holds only the frames that were used: the camera's period from its rig file.
  const session::FrameEvidence first = camera.upcoming()->evidence;
  const auto period_ns = static_cast<std::int64_t>(1e9 / rig.cameras.front().fps);
  std::uint64_t id = 0;
  for (std::int64_t k = FrameRhythm::kFirst; k > 0; --k) {
    const std::int64_t timestamp_ns = first.timestamp_ns - delay_ns - k * period_ns;
    const FrameInfo info{.sequence = first.sequence + 100 - static_cast<std::uint64_t>(k),
                         .timestamp_ns = timestamp_ns,
                         .arrival_ns = timestamp_ns,
                         .flags = kFrameMonotonic,
                         .exposure_us = first.exposure_read_us};
    ++id;
    send(timestamp_ns, event::FrameArrived{id, state.stream, info, id, true});
  }
  EXPECT_EQ(state.phase, Phase::running);
  int n_good = 0;
  while (const session::FrameRecord* record = camera.upcoming()) {
    const session::FrameEvidence e = record->evidence;
    const auto frame = camera.next(std::chrono::steady_clock::now());
    EXPECT_TRUE(frame.has_value());
    send(e.t_ack_ns,
         event::LightShown{state.job,
                           {e.t_command_ns, e.t_ack_ns, e.t_shown_ns.value(), e.tag_echo}});
    FrameInfo info = frame->info();
    info.timestamp_ns -= delay_ns;
    info.sequence += 100;
    ++id;
    send(e.t_next_change_ns, event::FrameArrived{id, state.stream, info, id, true});
    send(e.t_next_change_ns, event::LightConfirmed{id, e.t_next_change_ns, e.tag, 1});
    for (const Action& action : actions) {
      if (const auto* check = std::get_if<action::CheckFrame>(&action)) {
        EXPECT_EQ(check->evidence.t_exposure_start_ns, e.t_exposure_start_ns);
        EXPECT_EQ(check->evidence.tag, e.tag);
        const event::FrameChecked good{check->frame, check->shot, check->evidence, ""};
        send(e.t_next_change_ns, good);
        send(e.t_next_change_ns, event::FrameCommitted{good.frame, good.shot});
        ++n_good;
        break;
      }
    }
  }
  return n_good;
}

TEST(Replay, AnOldSessionPassesTheSequencerAgainFrameByFrame) {
  testing::TemporaryFolder folder;
  Rig rig;
  const std::filesystem::path session = capture_session(folder.path(), rig);
  const Plan plan = plan_from_json(read_file(session / "plan.json"), "plan.json");
  CameraSpec spec = rig.cameras.front();
  spec.device = session.string();
  ReplayCamera camera;
  ASSERT_TRUE(camera.start(spec).has_value());
  EXPECT_EQ(replay(camera, rig, plan, 0), 8);
  // Had the timestamps meant a moment 200 ms earlier, not one frame would have been taken.
  ASSERT_TRUE(camera.start(spec).has_value());
  EXPECT_EQ(replay(camera, rig, plan, 200'000'000), 0);
}

TEST(Replay, WhatIsNoSessionIsRefused) {
  testing::TemporaryFolder folder;
  CameraSpec spec;
  spec.device = folder.path().string();
  ReplayCamera camera;
  EXPECT_FALSE(camera.start(spec).has_value());
}

}  // namespace
}  // namespace haarlight::capture
