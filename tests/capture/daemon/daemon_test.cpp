// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/daemon.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <functional>
#include <string_view>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/thread_pulse.h"
#include "haarlight/capture/daemon/daemon_client.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/session/session.h"
#include "session/storage.h"
#include "session/verify.h"
#include "tests/capture/daemon_bench.h"
#include "tests/capture/session_truth.h"

namespace haarlight::capture {
namespace {

using testing::expect_true_session;
using ::testing::HasSubstr;
using namespace std::chrono_literals;

const std::string kPlan = "schema = 1\nname = \"quick\"\npatterns = \"one_at_a_time\"\n";
const std::string kPlanWithDarks = kPlan + "darks_every = 16\n";

/// The kernel's files, until a test says what fails.
class FailingStorage final : public session::DiskStorage {
 public:
  explicit FailingStorage(Clock& clock) : clock_(clock) {}

  std::atomic<bool> is_full{false};
  std::atomic<int> reserve_ms{0};  ///< how long reserving space takes

  Result<void> reserve(const std::filesystem::path& path, std::uint64_t bytes) override {
    clock_.sleep_for(std::chrono::milliseconds(reserve_ms));
    return session::DiskStorage::reserve(path, bytes);
  }
  Result<void> write(const std::filesystem::path& path,
                     std::span<const std::byte> bytes) override {
    if (is_full) {
      return fail(Errc::no_space, "write: no space left on device", ENOSPC);
    }
    return refused(0).and_then([&] { return session::DiskStorage::write(path, bytes); });
  }
  Result<void> sync_file(const std::filesystem::path& path) override {
    return refused(1).and_then([&] { return session::DiskStorage::sync_file(path); });
  }
  Result<void> rename(const std::filesystem::path& from,
                      const std::filesystem::path& to) override {
    return refused(2).and_then([&] { return session::DiskStorage::rename(from, to); });
  }
  Result<void> sync_folder(const std::filesystem::path& folder) override {
    return refused(3).and_then([&] { return session::DiskStorage::sync_folder(folder); });
  }
  /// One of the next operations of each kind (write, sync, rename, folder's sync) fails.
  void fail_each_kind(int error) {
    for (std::atomic<int>& one : to_fail_) {
      one = error;
    }
  }
  [[nodiscard]] bool has_failed_each_kind() const {
    return std::all_of(to_fail_.begin(), to_fail_.end(), [](const auto& n) { return n == 0; });
  }

 private:
  Result<void> refused(std::size_t kind) {
    const int error = to_fail_.at(kind).exchange(0);
    if (error == 0) {
      return {};
    }
    return fail(error == ENOSPC ? Errc::no_space : Errc::io, "the disk refuses", error);
  }
  Clock& clock_;
  std::array<std::atomic<int>, 4> to_fail_{};
};

class DaemonTest : public testing::DaemonBench {
 protected:
  explicit DaemonTest(testing::BenchTime time = testing::BenchTime::virtual_time)
      : DaemonBench(time) {}
  session::Storage& storage() override { return storage_; }
  void configure(DaemonConfig& config) override { config.on_turn = on_turn_; }

  FailingStorage storage_{clock_};
  std::function<void(std::string_view)> on_turn_;
  std::atomic<bool> may_look_{false};  ///< outlives the daemon's threads
};

TEST_F(DaemonTest, CapturesAPlanAndEveryFrameShowsItsOwnLight) {
  start();
  const RunReceipt receipt = daemon_->run(kPlanWithDarks, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_TRUE(light_->is_dark());
  EXPECT_EQ(hands_->n_held, 0);
}

TEST_F(DaemonTest, AClippedShotIsTakenAgainAndItsAttemptsAreKept) {
  start();
  constexpr int kShot = 5;
  hands_->clipped_tag = kFirstTag + kShot;
  const RunReceipt receipt =
      daemon_->run(kPlan + "max_saturated_share = 0.1\nattempts = 3\n", "p.toml");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_EQ(daemon_->state().counters.checks_failed, 2U);
  const session::Session session = session::Session::open(receipt.folder);
  const session::FrameRecord& frame = session.info().frames[kShot];
  EXPECT_EQ(frame.attempt, 2);
  EXPECT_EQ(frame.evidence.verdict, session::FrameVerdict::saturated);
  const session::VerifyReport report = session::verify_session(receipt.folder);
  EXPECT_TRUE(report.is_good()) << report.problems.front();
  EXPECT_EQ(report.n_suspect, 1);
  EXPECT_THAT(report.notes, ::testing::IsSupersetOf(
                                {HasSubstr("frames/000005_a2.tif: saturated"),
                                 HasSubstr("aside/000005_a0.tif: not used: saturated: 0.5"),
                                 HasSubstr("aside/000005_a1.tif: not used: saturated: 0.5")}));
}

TEST_F(DaemonTest, ASecondRunIsRefusedWhileOneIsOn) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  EXPECT_THROW((void)daemon_->run(kPlan, "p.toml"), Error);
}

TEST_F(DaemonTest, ARunRequestedBeforeItHasLookedAroundFollows) {
  on_turn_ = [this](std::string_view thread) {
    while (thread == "control" && !may_look_) {
      clock_.sleep_for(1ms);
    }
  };
  launch();
  EXPECT_EQ(daemon_->state().phase, Phase::boot);
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  EXPECT_THROW((void)daemon_->run(kPlan, "p.toml"), Error);
  may_look_ = true;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AControllerRestartIsSurvivedWithoutTheOperator) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(10));
  light_->restart();
  ASSERT_TRUE(wait_for_commits(20));
  light_->restart();
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_EQ(daemon_->state().counters.controller_reboots, 2U);
}

TEST_F(DaemonTest, AnUnpluggedControllerSuspendsWithinASecondAndTheRunGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  light_->set_gone(true);
  EXPECT_TRUE(
      wait_within(1s, [](const DaemonState& s) { return s.phase == Phase::suspended; }));
  EXPECT_EQ(daemon_->state().reasons, kControllerLost);
  light_->set_gone(false);
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AnUnpluggedCameraSuspendsWithinASecondDarkAndTheRunGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  hands_->is_gone = true;
  EXPECT_TRUE(
      wait_within(1s, [](const DaemonState& s) { return s.phase == Phase::suspended; }));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  hands_->is_gone = false;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, ASilentCameraSuspendsWithinASecond) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  hands_->is_silent = true;
  EXPECT_TRUE(
      wait_within(1s, [](const DaemonState& s) { return s.phase == Phase::suspended; }));
  hands_->is_silent = false;
  EXPECT_TRUE(wait_for(Phase::done));
}

TEST_F(DaemonTest, AFullDiskSuspendsAndTheRunGoesOnWhenThereIsSpace) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  storage_.is_full = true;
  ASSERT_TRUE(wait_for(Phase::suspended));
  EXPECT_EQ(daemon_->state().reasons, kDiskFull);
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  storage_.is_full = false;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AWriteSyncOrRenameThatFailsOnceIsRepeated) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  for (const int error : {ENOSPC, EIO}) {
    ASSERT_TRUE(wait_for_commits(error == ENOSPC ? 5 : 20));
    storage_.fail_each_kind(error);
    ASSERT_TRUE(
        wait_until([this](const DaemonState&) { return storage_.has_failed_each_kind(); }));
  }
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  EXPECT_EQ(daemon_->state().counters.commit_faults, 8U);
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, PauseDarkensAndResumeGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::Pause{});
  ASSERT_TRUE(wait_for(Phase::paused));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  daemon_->request(event::Resume{});
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AnAbortAnswersWithin200MsEvenWhenTheBusHangs) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  light_->hang_next(1000ms);
  clock_.sleep_for(50ms);
  daemon_->request(event::Abort{});
  EXPECT_TRUE(wait_within(200ms, [](const DaemonState& s) { return s.phase == Phase::idle; }));
}

TEST_F(DaemonTest, AnAbortedSessionCanBeGoneOnWith) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle));
  (void)daemon_->resume_session(receipt.session);
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AFullDiskAtTheStartIsWaitedFor) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(20));
  daemon_.reset();
  // A stray file goes aside with a note of why, which needs space.
  std::filesystem::copy_file(receipt.folder / session::frame_file_name(0, 0),
                             receipt.folder / "frames/stray.tif");
  storage_.is_full = true;
  start();
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.is_opening && s.reason_text.find("no space") != std::string::npos;
  }));
  storage_.is_full = false;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AnAbortedSessionDoesNotGoOnByItself) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::Pause{});
  // Dark, and nothing on its way: such an abort ends in the same step in which it begins.
  ASSERT_TRUE(wait_until([this](const DaemonState& s) {
    return s.phase == Phase::paused && light_->is_dark() && hands_->n_held == 0;
  }));
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle));
  daemon_.reset();
  const std::size_t n_changes = light_->changes().size();
  start();
  ASSERT_TRUE(wait_for(Phase::idle));
  clock_.sleep_for(100ms);
  EXPECT_EQ(daemon_->state().phase, Phase::idle);
  EXPECT_EQ(light_->changes().size(), n_changes) << "nothing was lit again";
}

TEST_F(DaemonTest, AllOffWhileASessionIsOpenedHoldsTheRun) {
  start();
  storage_.reserve_ms = 200;
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  daemon_->request(event::SafeOff{});
  ASSERT_TRUE(wait_until([](const DaemonState& s) { return !s.is_opening; }));
  EXPECT_EQ(daemon_->state().session, receipt.session);
  storage_.reserve_ms = 0;
  clock_.sleep_for(200ms);
  EXPECT_EQ(daemon_->state().phase, Phase::safe_off);
  for (const firmware_iface::FakeLight::Change& change : light_->changes()) {
    EXPECT_EQ(change.tag, 0U) << "something was lit after all-off";
  }
  daemon_->request(event::Resume{});
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, APauseAndAnAbortWhileASessionIsOpenedAreMeantForIt) {
  start();
  storage_.reserve_ms = 200;
  (void)daemon_->run(kPlan, "p.toml");
  daemon_->request(event::Pause{});
  ASSERT_TRUE(wait_for(Phase::paused));
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle));
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  daemon_->request(event::Abort{});
  ASSERT_TRUE(
      wait_until([](const DaemonState& s) { return !s.is_opening && s.phase == Phase::idle; }));
  EXPECT_TRUE(wait_until([&](const DaemonState&) {
    return std::filesystem::exists(receipt.folder / "aborted.txt");
  }));
  EXPECT_EQ(daemon_->state().n_committed, 0);
}

TEST_F(DaemonTest, AStoppedDaemonGoesOnAtItsNextStart) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(20));
  daemon_.reset();
  EXPECT_TRUE(light_->is_dark()) << "the destructor darkens";
  start();
  ASSERT_TRUE(wait_for(Phase::done));
  EXPECT_EQ(daemon_->state().session, receipt.session);
  EXPECT_GE(daemon_->state().recovery->n_committed, 20);
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AShotIsTakenAgainAfterTheSessionIsDone) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  daemon_->request(event::Reshoot{{7}});
  ASSERT_TRUE(wait_until(
      [](const DaemonState& s) { return s.phase == Phase::done && s.counters.commits == 65; }));
  expect_true_session(receipt.folder);
  EXPECT_TRUE(std::filesystem::exists(receipt.folder / session::frame_file_name(7, 1)));
}

TEST_F(DaemonTest, AShotTakenAgainOnAFullDiskWaitsForSpace) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  storage_.is_full = true;
  daemon_->request(event::Reshoot{{7}});
  ASSERT_TRUE(wait_for(Phase::suspended));
  EXPECT_EQ(daemon_->state().reasons, kDiskFull);
  storage_.is_full = false;
  ASSERT_TRUE(wait_until(
      [](const DaemonState& s) { return s.phase == Phase::done && s.counters.commits == 65; }));
  expect_true_session(receipt.folder);
  EXPECT_EQ(session::Session::open(receipt.folder).info().frames[7].attempt, 1);
}

TEST_F(DaemonTest, ShotsTakenAgainGoOnInTheNextDaemon) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done));
  event::Reshoot all;
  for (int shot = 0; shot < 64; ++shot) {
    all.shots.push_back(shot);
  }
  daemon_->request(all);
  ASSERT_TRUE(wait_until([](const DaemonState& s) { return s.counters.commits >= 70; }));
  daemon_.reset();
  start();
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(receipt.folder);
  const session::Session session = session::Session::open(receipt.folder);
  for (const session::FrameRecord& frame : session.info().frames) {
    EXPECT_EQ(frame.attempt, 1) << frame.file;
  }
}

TEST_F(DaemonTest, AllOffDarkensAndOnlyTheOperatorGoesOn) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::SafeOff{});
  ASSERT_TRUE(wait_for(Phase::safe_off));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  clock_.sleep_for(100ms);
  EXPECT_EQ(daemon_->state().phase, Phase::safe_off);
  EXPECT_TRUE(light_->is_dark());
  daemon_->request(event::Resume{});
  EXPECT_TRUE(wait_for(Phase::done));
}

TEST_F(DaemonTest, APlanAboveTheFacesPowerIsRefusedAndNothingIsLit) {
  rig_.faces.front().max_power = Watts(100.0);
  start();
  EXPECT_THROW(
      (void)daemon_->run("schema = 1\nname = \"p\"\npatterns = \"bins\"\nbin = 8\n", "p"),
      Error);
  EXPECT_TRUE(light_->changes().empty());
}

TEST_F(DaemonTest, AModeThatTheCameraCannotDoIsRefused) {
  rig_.sync = SyncMode::light_leads;  // the fake camera runs freely
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::idle && s.reason_text.find("trigger") != std::string::npos;
  }));
  EXPECT_EQ(daemon_->state().n_committed, 0);
}

TEST_F(DaemonTest, AControllerWithoutATableIsRefusedWhereTheCameraLeads) {
  rig_.sync = SyncMode::camera_leads;
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_until([](const DaemonState& s) {
    return s.phase == Phase::idle &&
           s.reason_text.find("no pattern table") != std::string::npos;
  }));
}

// ---- HTTP ----

class DaemonHttpTest : public DaemonTest {
 protected:
  DaemonHttpTest() : DaemonTest(testing::BenchTime::real) {}
  void SetUp() override { start(true); }
  DaemonClient client() {
    return DaemonClient({.url = "http://127.0.0.1:" + std::to_string(daemon_->http_port())});
  }
};

TEST_F(DaemonHttpTest, RunsAPlanAndTellsAboutIt) {
  DaemonClient client = this->client();
  const DaemonReply begun = client.post("/v1/run?name=p.toml", kPlan);
  EXPECT_EQ(begun.status, 202) << begun.body;
  ASSERT_TRUE(wait_for(Phase::done));
  const std::string id = daemon_->state().session;
  EXPECT_THAT(client.get("/v1/state").body, HasSubstr("\"committed\":64"));
  EXPECT_THAT(client.get("/v1/sessions").body, HasSubstr(id));
  EXPECT_THAT(client.get("/v1/sessions/" + id).body, HasSubstr("\"is_finished\":true"));
  EXPECT_THAT(client.get("/v1/sessions/" + id + "/shots").body, HasSubstr("\"shot\":63"));
  EXPECT_THAT(client.get("/v1/sessions/" + id + "/shots/9").body, HasSubstr("\"tag_echo\":10"));
  EXPECT_THAT(client.get("/v1/sessions/" + id + "/shots/9/preview.jpg").body,
              ::testing::StartsWith("\xff\xd8\xff"));
  EXPECT_EQ(client.get("/v1/preview.jpg").status, 404) << "the camera rests";
  EXPECT_THAT(client.get("/metrics").body, HasSubstr("haarlight_commits_total 64"));
  EXPECT_EQ(client.get("/healthz").status, 200);
}

TEST_F(DaemonHttpTest, BadRequestsAreAnsweredWithWhatWhereAndHint) {
  DaemonClient client = this->client();
  for (const DaemonReply& reply :
       {client.post("/v1/run", "nonsense = = 1"), client.post("/v1/run", "{\"schema\": 1}"),
        client.post("/v1/run?session=../../etc"), client.post("/v1/reshoot", "[]"),
        client.post("/v1/reshoot", "{\"shots\": [9999]}"),
        client.post("/v1/reshoot", "{\"shots\": \"a\"}"), client.get("/v1/sessions/nothing"),
        client.get("/v1/sessions/nothing/shots/1"), client.get("/v1/preview.jpg"),
        client.get("/v1/unknown")}) {
    EXPECT_GE(reply.status, 400) << reply.body;
    EXPECT_LT(reply.status, 500) << reply.body;
    EXPECT_THAT(reply.body, HasSubstr("\"cure\""));
  }
  EXPECT_EQ(daemon_->state().phase, Phase::idle);
}

/// Bodies of every wrong type and shape everywhere one is read.
TEST_F(DaemonHttpTest, NoBodyCrashesIt) {
  DaemonClient client = this->client();
  const std::string deep(100000, '[');
  const std::vector<std::string> bodies = {"",
                                           "null",
                                           "0",
                                           "\"shots\"",
                                           "[]",
                                           "{}",
                                           "[1]",
                                           "{\"shots\": null}",
                                           "{\"shots\": {}}",
                                           "{\"shots\": [null]}",
                                           "{\"shots\": [[3]]}",
                                           "{\"shots\": [-1]}",
                                           "{\"shots\": [1.5]}",
                                           "{\"shots\": [1e300]}",
                                           "{\"shots\": [99999999999999999999]}",
                                           "{\"shots\": [18446744073709551615]}",
                                           "{\"lights\": [1.5]}",
                                           "{\"lights\": [18446744073709551615]}",
                                           "{\"lights\": [\"1\"]}",
                                           "{\"lights\": [0], \"level\": -1}",
                                           "{\"lights\": [0], \"level\": 1e99}",
                                           "{\"lights\": [0], \"level\": \"a\"}",
                                           "{\"lights\": [0], \"exposure_us\": -1}",
                                           "{\"lights\": [0, 0]}",
                                           "{\"lights\": [0], \"exposure_us\": 1e-300}",
                                           "{\"schema\": \"1\"}",
                                           "{\"schema\": 1, \"shots\": 3}",
                                           "{\"schema\": 1, \"shots\": [[]]}",
                                           "{\"schema\": 1e400}",
                                           "schema = 1\npatterns = 7\n",
                                           "patterns = [[[",
                                           "\xff\xfe",
                                           std::string("{\"shots\"\0:[1]}", 13),
                                           deep,
                                           "{\"shots\":" + deep,
                                           "a" + deep};
  for (const char* path : {"/v1/run", "/v1/run?session=%00", "/v1/run?session=..",
                           "/v1/run?name=%ff%fe", "/v1/reshoot", "/v1/preview"}) {
    for (const std::string& body : bodies) {
      const DaemonReply reply = client.post(path, body);
      EXPECT_GE(reply.status, 400) << path << " " << body.substr(0, 80);
      EXPECT_LT(reply.status, 500) << path << " " << body.substr(0, 80) << reply.body;
      EXPECT_THAT(reply.body, HasSubstr("\"cure\"")) << path << " " << body.substr(0, 80);
    }
  }
  for (const char* path : {"/v1/sessions/%2e%2e/shots", "/v1/sessions/a%00b",
                           "/v1/sessions/x/shots/99999999999999999999",
                           "/v1/sessions/x/shots/-1/preview.jpg", "/v1/sessions/%ff"}) {
    EXPECT_EQ(client.get(path).status / 100, 4) << path;
  }
  EXPECT_EQ(client.get("/healthz").status, 200);
  EXPECT_EQ(daemon_->state().phase, Phase::idle);
  EXPECT_TRUE(light_->changes().empty());
}

TEST_F(DaemonHttpTest, AShotIsTakenAgainOnlyWhereASessionIsOpen) {
  DaemonClient client = this->client();
  EXPECT_EQ(client.post("/v1/reshoot", "{\"shots\": [3]}").status, 409);
  EXPECT_EQ(client.post("/v1/run", kPlan).status, 202);
  ASSERT_TRUE(wait_for(Phase::done));
  EXPECT_EQ(client.post("/v1/reshoot", "{\"shots\": [3, 4]}").status, 202);
  EXPECT_TRUE(wait_until(
      [](const DaemonState& s) { return s.phase == Phase::done && s.counters.commits == 66; }));
}

TEST_F(DaemonHttpTest, APreviewLightsWhatIsRequestedAndStoresNothing) {
  DaemonClient client = this->client();
  EXPECT_EQ(client.post("/v1/preview", "{\"lights\": [5, 9], \"level\": 1000}").status, 202);
  ASSERT_TRUE(wait_until([this](const DaemonState& s) {
    return s.is_preview && s.phase == Phase::running && !light_->is_dark();
  }));
  const std::vector<firmware_iface::ElementLevel> lit = light_->changes().back().pattern;
  ASSERT_EQ(lit.size(), 2U);
  EXPECT_EQ(lit[1].element, 9);
  EXPECT_EQ(lit[1].level, 1000);
  ASSERT_TRUE(
      wait_until([this](const DaemonState&) { return daemon_->newest_frame() != nullptr; }));
  EXPECT_THAT(client.get("/v1/preview.jpg").body, ::testing::StartsWith("\xff\xd8\xff"));
  EXPECT_EQ(client.post("/v1/run", kPlan).status, 409);
  EXPECT_EQ(client.post("/v1/abort").status, 202);
  ASSERT_TRUE(wait_for(Phase::idle));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }));
  EXPECT_TRUE(std::filesystem::is_empty(folder_.path() / "sessions"));
  EXPECT_EQ(client.post("/v1/preview", "{\"lights\": [64]}").status, 400);
  EXPECT_EQ(client.post("/v1/preview", "{\"lights\": 3}").status, 400);
}

TEST_F(DaemonHttpTest, AllOffIsAcceptedInEveryState) {
  DaemonClient client = this->client();
  EXPECT_EQ(client.post("/v1/all-off").status, 202);
  ASSERT_TRUE(wait_for(Phase::safe_off));
  EXPECT_EQ(client.post("/v1/resume").status, 202);
  ASSERT_TRUE(wait_for(Phase::idle));
}

}  // namespace
}  // namespace haarlight::capture
