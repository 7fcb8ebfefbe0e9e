// SPDX-License-Identifier: Apache-2.0
/// @file
/// The service manager's watchdog is fed while every thread makes progress: each thread is
/// stalled in turn, and the daemon must name it. Under virtual time, with fake devices.

#include <atomic>

#include <gtest/gtest.h>

#include "tests/capture/daemon_bench.h"

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;

constexpr auto kLimit = 500ms;
const std::string kLongPlan =
    "schema = 1\nname = \"long\"\npatterns = \"one_at_a_time\"\nrepeats = 10\n";

/// A gate that a thread stands at while it is shut.
class Gate {
 public:
  explicit Gate(Clock& clock) : clock_(clock) {}
  void pass() const {
    while (is_shut_) {
      clock_.sleep_for(1ms);
    }
  }
  void shut(bool is_shut) { is_shut_ = is_shut; }

 private:
  Clock& clock_;
  std::atomic<bool> is_shut_{false};
};

class GatedCamera final : public Camera {
 public:
  GatedCamera(std::unique_ptr<Camera> camera, const Gate& gate)
      : camera_(std::move(camera)), gate_(gate) {}
  Result<CameraSetup> start(const CameraSpec& spec) override { return camera_->start(spec); }
  Result<Frame> next(std::chrono::steady_clock::time_point deadline) override {
    gate_.pass();
    return camera_->next(deadline);
  }
  Result<double> set_exposure(double exposure_us) override {
    return camera_->set_exposure(exposure_us);
  }
  void stop() noexcept override { camera_->stop(); }

 private:
  std::unique_ptr<Camera> camera_;
  const Gate& gate_;
};

class GatedStorage final : public session::DiskStorage {
 public:
  explicit GatedStorage(const Gate& gate) : gate_(gate) {}
  Result<void> write(const std::filesystem::path& path,
                     std::span<const std::byte> bytes) override {
    gate_.pass();
    return session::DiskStorage::write(path, bytes);
  }

 private:
  const Gate& gate_;
};

class WatchdogTest : public testing::DaemonBench {
 protected:
  WatchdogTest() : DaemonBench(testing::BenchTime::virtual_time) {}
  void SetUp() override { start(); }
  void TearDown() override {  // no thread may stand at a gate when the daemon ends
    for (Gate* gate : {&camera_gate_, &control_gate_, &checks_gate_, &disk_gate_}) {
      gate->shut(false);
    }
    DaemonBench::TearDown();
  }
  Result<std::unique_ptr<Camera>> make_camera() override {
    return std::make_unique<GatedCamera>(std::make_unique<FakeCamera>(light_, hands_),
                                         camera_gate_);
  }
  session::Storage& storage() override { return storage_; }
  void configure(DaemonConfig& config) override {
    config.hang_limit = kLimit;
    config.on_turn = [this](std::string_view thread) {
      (thread == "control" ? control_gate_ : checks_gate_).pass();
    };
  }

  bool is_named(std::string_view thread) {
    return wait_until([&](const DaemonState&) { return daemon_->hanging_thread() == thread; });
  }
  void begin_run() {
    (void)daemon_->run(kLongPlan, "long.toml");
    ASSERT_TRUE(wait_for_commits(3));
  }
  void expect_named_while_shut(Gate& gate, std::string_view thread) {
    begin_run();
    gate.shut(true);
    EXPECT_TRUE(is_named(thread))
        << thread << " stands still, and \"" << daemon_->hanging_thread() << "\" is named";
    gate.shut(false);
    EXPECT_TRUE(is_named("")) << daemon_->hanging_thread();
  }

  Gate camera_gate_{clock_};
  Gate control_gate_{clock_};
  Gate checks_gate_{clock_};
  Gate disk_gate_{clock_};
  GatedStorage storage_{disk_gate_};
};

TEST_F(WatchdogTest, AnIdleDaemonIsHealthy) {
  ASSERT_TRUE(wait_for(Phase::idle));
  clock_.sleep_for(3 * kLimit);
  EXPECT_TRUE(is_named(""));
}

TEST_F(WatchdogTest, NamesTheLightThread) {
  begin_run();
  light_->hang_next(6 * kLimit);
  EXPECT_TRUE(is_named("light"));
  EXPECT_TRUE(is_named(""));
}

TEST_F(WatchdogTest, NamesTheCameraThread) { expect_named_while_shut(camera_gate_, "camera"); }

TEST_F(WatchdogTest, NamesTheWriterThread) { expect_named_while_shut(disk_gate_, "writer"); }

TEST_F(WatchdogTest, NamesTheCheckingThread) {
  expect_named_while_shut(checks_gate_, "checks");
}

TEST_F(WatchdogTest, NamesTheControlThreadAndTheDeadmanPutsTheLightsOut) {
  begin_run();
  control_gate_.shut(true);
  EXPECT_TRUE(is_named("control"));
  EXPECT_TRUE(wait_until([this](const DaemonState&) { return light_->is_dark(); }))
      << "the light thread's deadman";
  control_gate_.shut(false);
  EXPECT_TRUE(is_named(""));
}

}  // namespace
}  // namespace haarlight::capture
