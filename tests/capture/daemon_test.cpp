#include "capture/daemon.h"

#include <atomic>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/daemon_client.h"
#include "capture/fake_camera.h"
#include "capture/fake_light_array.h"
#include "capture/tag_rows.h"
#include "capture/thread_pulse.h"
#include "core/error.h"
#include "core/files.h"
#include "session/frame_tiff.h"
#include "session/session.h"
#include "session/storage.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;
using namespace std::chrono_literals;

const std::string kPlan = "schema = 1\nname = \"quick\"\npatterns = \"one_at_a_time\"\n";
const std::string kPlanWithDarks = kPlan + "darks_every = 16\n";

/// The kernel's files, until a test says the disk is full.
class FillableStorage final : public Storage {
 public:
  std::atomic<bool> is_full{false};

  Result<void> write(const std::filesystem::path& path,
                     std::span<const std::byte> bytes) override {
    if (is_full) {
      return fail(Errc::no_space, "write: no space left on device", ENOSPC);
    }
    return disk_.write(path, bytes);
  }
  Result<void> sync_file(const std::filesystem::path& path) override {
    return disk_.sync_file(path);
  }
  Result<void> rename(const std::filesystem::path& from,
                      const std::filesystem::path& to) override {
    return disk_.rename(from, to);
  }
  Result<void> sync_folder(const std::filesystem::path& folder) override {
    return disk_.sync_folder(folder);
  }
  Result<std::uint64_t> free_bytes(const std::filesystem::path& folder) override {
    return disk_.free_bytes(folder);
  }

 private:
  DiskStorage disk_;
};

class DaemonTest : public ::testing::Test {
 protected:
  DaemonTest() : rig_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    rig_.http.port = 0;
    rig_.storage.reserve_mb = 0.0;
  }

  void start(bool has_http = false) {
    daemon_ = std::make_unique<Daemon>(
        DaemonConfig{.rig = rig_,
                     .sessions = folder_.path() / "sessions",
                     .make_light = [this]() -> Result<std::unique_ptr<LightArray>> {
                       return std::make_unique<FakeLightArray>(light_);
                     },
                     .make_camera = [this]() -> Result<std::unique_ptr<Camera>> {
                       return std::make_unique<FakeCamera>(light_, hands_);
                     },
                     .storage = &storage_,
                     .has_http = has_http});
    EXPECT_TRUE(wait_until([](const DaemonState& s) { return s.phase != Phase::boot; }));
  }

  template <class Predicate>
  bool wait_until(Predicate predicate, std::chrono::milliseconds limit = 20s) {
    const auto deadline = std::chrono::steady_clock::now() + limit;
    while (std::chrono::steady_clock::now() < deadline) {
      if (predicate(daemon_->state())) {
        return true;
      }
      std::this_thread::sleep_for(1ms);
    }
    return false;
  }
  bool wait_for(Phase phase) {
    return wait_until([phase](const DaemonState& s) { return s.phase == phase; });
  }
  bool wait_for_commits(int n) {
    return wait_until([n](const DaemonState& s) { return s.n_committed >= n; });
  }

  /// Every frame of a finished session is decoded to its own shot's tag.
  void expect_true_session(const std::filesystem::path& folder) const {
    const Session session = Session::open(folder);
    ASSERT_EQ(session.info().frames.size(), session.info().shots.size());
    for (const FrameRecord& frame : session.info().frames) {
      const MappedFile file(folder / frame.file);
      const FrameTiffHeader header = read_frame_tiff_header(file.bytes(), frame.file);
      const int active = session.info().form.height;
      const std::vector<std::byte> rows =
          read_frame_tiff_rows(file.bytes(), header, active, header.height, frame.file);
      const auto tag = decode_tag_rows({reinterpret_cast<const std::uint16_t*>(rows.data()),
                                        header.height - active, header.width, 1});
      ASSERT_TRUE(tag.has_value()) << frame.file;
      EXPECT_FALSE(tag->is_mixed) << frame.file;
      EXPECT_EQ(tag->tag, kFirstTag + static_cast<std::uint32_t>(frame.shot)) << frame.file;
    }
  }

  testing::TemporaryFolder folder_;
  Rig rig_;
  FillableStorage storage_;
  std::shared_ptr<FakeLight> light_ = std::make_shared<FakeLight>();
  std::shared_ptr<FakeCameraHands> hands_ = std::make_shared<FakeCameraHands>();
  std::unique_ptr<Daemon> daemon_;
};

TEST_F(DaemonTest, CapturesAPlanAndEveryFrameShowsItsOwnLight) {
  start();
  const RunReceipt receipt = daemon_->run(kPlanWithDarks, "p.toml");
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
  EXPECT_TRUE(light_->is_dark());
  EXPECT_EQ(hands_->n_held, 0);
}

TEST_F(DaemonTest, ASecondRunIsRefusedWhileOneIsOn) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  EXPECT_THROW((void)daemon_->run(kPlan, "p.toml"), Error);
}

TEST_F(DaemonTest, AControllerRestartIsSurvivedWithoutAPerson) {
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
  EXPECT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::suspended; }, 1s));
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
  EXPECT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::suspended; }, 1s));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }, 1s));
  hands_->is_gone = false;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, ASilentCameraSuspendsWithinASecond) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  hands_->is_silent = true;
  EXPECT_TRUE(wait_until([](const DaemonState& s) { return s.phase == Phase::suspended; }, 1s));
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
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }, 1s));
  storage_.is_full = false;
  ASSERT_TRUE(wait_for(Phase::done)) << daemon_->state().reason_text;
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, PauseDarkensAndResumeGoesOn) {
  start();
  const RunReceipt receipt = daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::Pause{});
  ASSERT_TRUE(wait_for(Phase::paused));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }, 1s));
  daemon_->request(event::Resume{});
  ASSERT_TRUE(wait_for(Phase::done));
  expect_true_session(receipt.folder);
}

TEST_F(DaemonTest, AnAbortAnswersWithin200MsEvenWhenTheBusHangs) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  light_->hang_next(1000ms);
  std::this_thread::sleep_for(50ms);
  const auto begin = std::chrono::steady_clock::now();
  daemon_->request(event::Abort{});
  ASSERT_TRUE(wait_for(Phase::idle));
  // 200 ms are promised; 100 ms more for a loaded machine and the polling of this test.
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 300ms);
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
  EXPECT_TRUE(std::filesystem::exists(receipt.folder / frame_file_name(7, 1)));
}

TEST_F(DaemonTest, AllOffDarkensAndOnlyAPersonGoesOn) {
  start();
  (void)daemon_->run(kPlan, "p.toml");
  ASSERT_TRUE(wait_for_commits(5));
  daemon_->request(event::SafeOff{});
  ASSERT_TRUE(wait_for(Phase::safe_off));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }, 1s));
  std::this_thread::sleep_for(100ms);
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
  rig_.sync = SyncMode::camera_leads;
  EXPECT_THROW(start(), Error);
}

// ---- HTTP
// ------------------------------------------------------------------------------------

class DaemonHttpTest : public DaemonTest {
 protected:
  DaemonHttpTest() { start(true); }
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
  EXPECT_THAT(client.get("/v1/preview.jpg").body, ::testing::StartsWith("\xff\xd8\xff"));
  EXPECT_THAT(client.get("/metrics").body, HasSubstr("haarlight_commits_total 64"));
  EXPECT_EQ(client.get("/healthz").status, 200);
}

TEST_F(DaemonHttpTest, BadRequestsAreAnsweredWithWhatWhereAndCure) {
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

TEST_F(DaemonHttpTest, APreviewLightsWhatIsAskedAndStoresNothing) {
  DaemonClient client = this->client();
  EXPECT_EQ(client.post("/v1/preview", "{\"lights\": [5, 9], \"level\": 1000}").status, 202);
  ASSERT_TRUE(wait_until([this](const DaemonState& s) {
    return s.is_preview && s.phase == Phase::running && !light_->is_dark();
  }));
  const std::vector<ElementLevel> lit = light_->changes().back().pattern;
  ASSERT_EQ(lit.size(), 2U);
  EXPECT_EQ(lit[1].element, 9);
  EXPECT_EQ(lit[1].level, 1000);
  ASSERT_TRUE(
      wait_until([this](const DaemonState&) { return daemon_->preview().has_value(); }));
  EXPECT_THAT(client.get("/v1/preview.jpg").body, ::testing::StartsWith("\xff\xd8\xff"));
  EXPECT_EQ(client.post("/v1/run", kPlan).status, 409);
  EXPECT_EQ(client.post("/v1/abort").status, 202);
  ASSERT_TRUE(wait_for(Phase::idle));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }, 1s));
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
}  // namespace haarlight
