// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <optional>
#include <utility>

#include <gtest/gtest.h>

#include "capture/camera/fake_camera.h"
#include "capture/daemon/daemon.h"
#include "core/virtual_clock.h"
#include "firmware_iface/fake_light_array.h"
#include "haarlight/core/rig/rig.h"
#include "session/storage.h"
#include "tests/temporary_folder.h"

/// @file
/// A daemon with fake devices and a folder of its own, for tests; each part can
/// replace another. On the real clock, or under virtual time: then the test's thread is one of
/// the clock's, nothing happens between its waits, and what it measures is exact. A request for
/// a live picture waits for a frame, so a test that asks for one needs the real clock.

namespace haarlight::testing {

enum class BenchTime { real, virtual_time };

class DaemonBench : public ::testing::Test {
 protected:
  explicit DaemonBench(BenchTime time = BenchTime::real)
      : is_virtual_(time == BenchTime::virtual_time),
        clock_(is_virtual_ ? virtual_clock_ : real_clock()),
        rig_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    rig_.http.port = 0;
    rig_.storage.reserve_mb = 0.0;
    if (is_virtual_) {
      here_.emplace(virtual_clock_);
    }
  }
  /// Before the members of a derived class, which its threads use, are gone.
  void TearDown() override { daemon_.reset(); }

  virtual Result<std::unique_ptr<firmware_iface::LightArray>> make_light() {
    return std::make_unique<firmware_iface::FakeLightArray>(light_);
  }
  virtual Result<std::unique_ptr<capture::Camera>> make_camera() {
    return std::make_unique<capture::FakeCamera>(light_, hands_);
  }
  virtual session::Storage& storage() { return disk_; }
  /// The last word on the daemon's settings.
  virtual void configure(capture::DaemonConfig& config) { static_cast<void>(config); }

  void start(bool has_http = false) {
    launch(has_http);
    EXPECT_TRUE(wait_until([](const capture::DaemonState& s) {
      return s.phase != capture::Phase::boot && s.phase != capture::Phase::recover;
    }));
  }
  /// As start(), without waiting until it has looked around.
  void launch(bool has_http = false) {
    capture::DaemonConfig config{.rig = rig_,
                                 .sessions = folder_.path() / "sessions",
                                 .make_light = [this] { return make_light(); },
                                 .make_camera = [this] { return make_camera(); },
                                 .storage = &storage(),
                                 .has_http = has_http,
                                 .clock = &clock_};
    configure(config);
    daemon_ = std::make_unique<capture::Daemon>(std::move(config));
  }

  /// Until then wait_until() looks again, so it is up to this late.
  static constexpr std::chrono::milliseconds kPoll{1};
  template <class Predicate>
  bool wait_until(Predicate predicate) {
    return is_reached(predicate, std::chrono::seconds(60));  // or it hangs
  }
  /// A promise in time, which only virtual time can hold it to.
  template <class Predicate>
  bool wait_within(std::chrono::milliseconds limit, Predicate predicate) {
    EXPECT_TRUE(is_virtual_);
    return is_reached(predicate, limit + kPoll);
  }
  bool wait_for(capture::Phase phase) {
    return wait_until([phase](const capture::DaemonState& s) { return s.phase == phase; });
  }
  bool wait_for_commits(int n) {
    return wait_until([n](const capture::DaemonState& s) { return s.n_committed >= n; });
  }

  template <class Predicate>
  bool is_reached(Predicate predicate, std::chrono::milliseconds limit) {
    for (const Clock::Time end = clock_.now() + limit; clock_.now() < end;) {
      if (predicate(daemon_->state())) {
        return true;
      }
      clock_.sleep_for(kPoll);
    }
    return predicate(daemon_->state());
  }

  const bool is_virtual_;
  VirtualClock virtual_clock_;
  std::optional<VirtualClock::Member> here_;
  Clock& clock_;
  TemporaryFolder folder_;
  Rig rig_;
  session::DiskStorage disk_;
  std::shared_ptr<firmware_iface::FakeLight> light_ =
      std::make_shared<firmware_iface::FakeLight>(clock_);
  std::shared_ptr<capture::FakeCameraHands> hands_ =
      std::make_shared<capture::FakeCameraHands>();
  std::unique_ptr<capture::Daemon> daemon_;
};

}  // namespace haarlight::testing
