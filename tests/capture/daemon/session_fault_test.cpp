// SPDX-License-Identifier: Apache-2.0
/// What befalls a session from outside, with fake devices: disks that fail at its ends, folders
/// that are moved or deleted, a controller that refuses what it took before.

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/capture/daemon/daemon_client.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/capture/daemon_bench.h"
#include "tests/capture/session_truth.h"

namespace haarlight::capture {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using testing::expect_true_session;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

const std::string kPlan = "schema = 1\nname = \"quick\"\npatterns = \"one_at_a_time\"\n";

/// The kernel's files, but for one name that the disk does not take.
class PickyStorage final : public session::DiskStorage {
 public:
  std::atomic<const char*> refused{nullptr};

  Result<void> rename(const fs::path& from, const fs::path& to) override {
    const char* name = refused;
    return name != nullptr && to.filename() == name
               ? fail(Errc::no_space, "rename: no space left on device", ENOSPC)
               : session::DiskStorage::rename(from, to);
  }
};

class SessionFault : public testing::DaemonBench {
 protected:
  SessionFault() : DaemonBench(testing::BenchTime::virtual_time) {}
  session::Storage& storage() override { return storage_; }
  [[nodiscard]] fs::path sessions() const { return folder_.path() / "sessions"; }
  [[nodiscard]] std::string url() const {
    return "http://127.0.0.1:" + std::to_string(daemon_->http_port());
  }

  PickyStorage storage_;
};

TEST_F(SessionFault, ItsEndOnAFullDiskCanBeAborted) {
  start();
  storage_.refused = "session.json";
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::finalise && s.counters.commit_faults > 0;
  }));
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle));
  EXPECT_TRUE(wait_until(
      [&](const DaemonState&) { return fs::exists(receipt.folder / "aborted.txt"); }));
  storage_.refused = nullptr;
  (void)daemon_->resume_session(receipt.session);
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  EXPECT_FALSE(fs::exists(receipt.folder / "aborted.txt"));
  expect_true_session(receipt.folder);
}

TEST_F(SessionFault, ARunRefusedAtItsOpeningLeavesNothingOnTheDisk) {
  rig_.storage.reserve_mb = 4.0;
  start();
  for (const char* file : {"start.json", "plan.json", "rig.toml"}) {
    storage_.refused = file;
    (void)daemon_->run(kPlan, "p.toml");
    ASSERT_TRUE(wait_until([](const DaemonState& s) { return !s.is_opening; }));
    EXPECT_THAT(daemon_->state().reason_text, HasSubstr("no space"));
    EXPECT_TRUE(fs::is_empty(sessions())) << file;
  }
}

TEST_F(SessionFault, WhatAStoppedMakingHasLeftIsClearedAwayAtTheStart) {
  const auto make = [this](const std::string& name, const std::vector<std::string>& files) {
    fs::create_directories(sessions() / name / "frames");
    fs::create_directories(sessions() / name / "aside");
    for (const std::string& file : files) {
      std::ofstream(sessions() / name / file) << "x";
    }
  };
  make("half", {"reserve.bin", "journal.sqlite", "journal.sqlite-wal", "plan.json.new1"});
  make("foreign", {"reserve.bin", "notes.txt"});
  make("frame", {"reserve.bin", "journal.sqlite", "frames/000000_a0.tif"});
  make("plain", {});  // nothing of ours in it
  start();
  EXPECT_FALSE(fs::exists(sessions() / "half"));
  EXPECT_TRUE(fs::exists(sessions() / "foreign" / "reserve.bin"));
  EXPECT_TRUE(fs::exists(sessions() / "frame" / "frames/000000_a0.tif"));
  EXPECT_TRUE(fs::exists(sessions() / "plain"));
}

TEST_F(SessionFault, AStrayRefusalSuspendsTheRunAndItGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  for (int i = 1; i <= 3; ++i) {
    ASSERT_TRUE(wait_for_commits(10 * i));
    light_->fail_next(1, Errc::refused);
    ASSERT_TRUE(wait_until([i](const DaemonState& s) {
      return s.counters.light_faults >= static_cast<std::uint64_t>(i);
    }));
  }
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(SessionFault, ARefusalThatStaysEndsTheRunDarkWithItsReason) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(10));
  light_->fail_next(1 << 30, Errc::refused);
  ASSERT_TRUE(wait_for(Phase::idle)) << daemon_->state().reason_text;
  EXPECT_THAT(daemon_->state().reason_text, HasSubstr("4 times in a row"));
  light_->fail_next(0);
}

TEST_F(SessionFault, ARefusalBeforeTheFirstLightEndsTheRunAtOnce) {
  start();
  light_->fail_next(1, Errc::refused);
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(
      wait_until([](const DaemonState& s) { return s.phase == Phase::idle && !s.is_opening; }));
  EXPECT_THAT(daemon_->state().reason_text, HasSubstr("refused"));
  EXPECT_EQ(daemon_->state().n_committed, 0);
}

TEST_F(SessionFault, OfTwoUnfinishedSessionsTheOneWrittenLastGoesOnAndTheOtherIsTold) {
  start();
  const RunReceipt first = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_.reset();
  fs::rename(first.folder, folder_.path() / "hidden");
  start();
  const RunReceipt second = daemon_->run(kPlan + "repeats = 2\n", "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_.reset();
  fs::rename(folder_.path() / "hidden", first.folder);
  // The one with the earlier name was at work last.
  const std::string earlier = std::min(first.session, second.session);
  const std::string later = std::max(first.session, second.session);
  fs::last_write_time(sessions() / earlier / "frames", fs::file_time_type::clock::now() + 1h);
  start(true);
  ASSERT_TRUE(wait_for(Phase::done));
  EXPECT_EQ(daemon_->state().session, earlier);
  EXPECT_THAT(daemon_->state().unfinished, ElementsAre(later));
  EXPECT_THAT(DaemonClient({.url = url()}).get("/v1/state").body,
              HasSubstr("\"unfinished\":[\"" + later + "\"]"));
  (void)daemon_->resume_session(later);
  ASSERT_TRUE(wait_until(
      [&later](const DaemonState& s) { return s.phase == Phase::done && s.session == later; }));
  EXPECT_TRUE(daemon_->state().unfinished.empty());
}

TEST_F(SessionFault, AFolderDeletedUnderTheRunIsSaidAndTheRunCanBeAborted) {
  start(true);
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(10));
  std::error_code error;  // the writer makes and renames files meanwhile
  while (fs::exists(receipt.folder)) {
    fs::remove_all(receipt.folder, error);
  }
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::suspended && s.reasons == kFolderGone;
  })) << daemon_->state().reason_text;
  EXPECT_THAT(daemon_->state().reason_text, HasSubstr(receipt.folder.string()));
  EXPECT_THAT(daemon_->state().reason_text, HasSubstr("moved or deleted"));
  EXPECT_THAT(DaemonClient({.url = url()}).get("/v1/state").body, HasSubstr("session_folder"));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  daemon_->request(event::Abort{});
  EXPECT_TRUE(wait_for(Phase::idle));
  EXPECT_FALSE(fs::exists(receipt.folder));
  const RunReceipt next = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(next.folder);
}

TEST_F(SessionFault, AFolderMovedAwayAndBackGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(10));
  fs::rename(receipt.folder, folder_.path() / "away");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::suspended && s.reasons == kFolderGone;
  })) << daemon_->state().reason_text;
  fs::rename(folder_.path() / "away", receipt.folder);
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

// What `haarlight capture -o` does to a finished session.
TEST_F(SessionFault, AMovedSessionIsShownAndTakenAgainByItsLink) {
  start(true);
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  const fs::path vase = folder_.path() / "vase";
  fs::rename(receipt.folder, vase);
  DaemonClient client({.url = url()});
  const DaemonReply gone = client.post("/v1/reshoot", R"({"shots": [7]})");
  EXPECT_EQ(gone.status, 409) << gone.body;
  EXPECT_THAT(gone.body, HasSubstr("not there any more"));
  EXPECT_EQ(daemon_->state().phase, Phase::done);
  fs::create_directory_symlink(vase, receipt.folder);
  EXPECT_EQ(client.get("/v1/sessions/" + receipt.session + "/map").status, 200);
  EXPECT_EQ(client.post("/v1/reshoot", R"({"shots": [7]})").status, 202);
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::done && s.counters.commits == 65;
  })) << daemon_->state().reason_text;
  expect_true_session(vase);
  EXPECT_TRUE(fs::exists(vase / session::frame_file_name(7, 1)));
}

TEST_F(SessionFault, LongListsComeInPages) {
  start(true);
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  DaemonClient client({.url = url()});
  const std::string of = "/v1/sessions/" + receipt.session;
  EXPECT_THAT(client.get(of + "/map?from=60&count=10").body, HasSubstr("\"marks\":\"oooo\""));
  EXPECT_THAT(client.get(of + "/layout?from=2&count=3").body, HasSubstr("\"light\":[2,3,4]"));
  const std::string shots = client.get(of + "/shots?from=63").body;
  EXPECT_THAT(shots, HasSubstr("\"shot\":63"));
  EXPECT_THAT(shots, ::testing::Not(HasSubstr("\"shot\":62")));
  EXPECT_THAT(shots, HasSubstr("\"count\":64"));
  EXPECT_EQ(client.get(of + "/shots?from=-1").status, 400);
  EXPECT_THAT(client.get(of + "/shots?from=1000").body, HasSubstr("\"shots\":[]"));
}

}  // namespace
}  // namespace haarlight::capture
