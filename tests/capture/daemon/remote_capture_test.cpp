// SPDX-License-Identifier: Apache-2.0
/// @file
/// A daemon with fake devices from outside: capture_remotely(), and what the looks show.

#include "capture/daemon/remote_capture.h"

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon/remote_look.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/capture/daemon_bench.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;

class RemoteCapture : public testing::DaemonBench {
 protected:
  void SetUp() override { start(true); }
  DaemonClient client() {
    return DaemonClient({.url = "http://127.0.0.1:" + std::to_string(daemon_->http_port())});
  }
};

TEST_F(RemoteCapture, WaitsForAPlanAndMovesItsSession) {
  RemoteCaptureOptions options;
  options.plan = HAARLIGHT_SOURCE_DIR "/configs/plans/one_at_a_time.toml";
  options.output = folder_ / "mine.session";
  DaemonClient client = this->client();
  const RemoteCaptureSummary summary = capture_remotely(client, options);
  EXPECT_EQ(summary.state.phase, "done");
  EXPECT_EQ(summary.state.committed, summary.state.shots);
  EXPECT_GE(summary.state.shots, 64);  // a shot for each of small8's lights
  EXPECT_GE(summary.state.frames, summary.state.shots);
  EXPECT_EQ(summary.folder, options.output);
  EXPECT_TRUE(std::filesystem::exists(folder_ / "mine.session/session.json"));
  // The daemon goes on showing it, by the link.
  EXPECT_EQ(summary.warning, "");
  const std::vector<RemoteSession> sessions = list_sessions(client);
  ASSERT_EQ(sessions.size(), 1U);
  EXPECT_EQ(sessions[0].id, summary.state.session);
  EXPECT_EQ(sessions[0].state, "finished");
  EXPECT_TRUE(std::filesystem::is_symlink(summary.state.folder));
  const ShotStory story = tell_shot(client, "", 9);
  EXPECT_THAT(story.text, HasSubstr("shot 9: "));
  EXPECT_THAT(frame_picture(client, story), HasSubstr("PNG"));
  EXPECT_THAT(state_text(ask_state(client)), HasSubstr("shots committed"));
}

TEST_F(RemoteCapture, WantsOnePlanOrSessionAndANewFolder) {
  DaemonClient client = this->client();
  RemoteCaptureOptions options;
  EXPECT_THROW((void)capture_remotely(client, options), Error);
  options.plan = HAARLIGHT_SOURCE_DIR "/configs/plans/one_at_a_time.toml";
  options.output = folder_.path();
  EXPECT_THROW((void)capture_remotely(client, options), Error);
  EXPECT_THROW((void)reshoot(client, {9999}), Error);
  EXPECT_THROW((void)tell_shot(client, "", 0), Error);
  EXPECT_EQ(ask_state(client).phase, "idle");
  EXPECT_EQ(fetch_local("http://127.0.0.1:1/v1/state"), "");
}

}  // namespace
}  // namespace haarlight::capture
