// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <memory>
#include <thread>
#include <utility>

#include <gtest/gtest.h>

#include "capture/camera/fake_camera.h"
#include "capture/daemon/daemon.h"
#include "firmware_iface/fake_light_array.h"
#include "haarlight/core/rig/rig.h"
#include "session/storage.h"
#include "tests/temporary_folder.h"

/// @file
/// A daemon on the real clock with fake devices and a folder of its own, for tests; each part
/// can replace another.

namespace haarlight::testing {

class DaemonBench : public ::testing::Test {
 protected:
  DaemonBench() : rig_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")) {
    rig_.http.port = 0;
    rig_.storage.reserve_mb = 0.0;
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
                                 .has_http = has_http};
    configure(config);
    daemon_ = std::make_unique<capture::Daemon>(std::move(config));
  }

  template <class Predicate>
  bool wait_until(Predicate predicate,
                  std::chrono::milliseconds limit = std::chrono::seconds(60)) {
    const auto deadline = std::chrono::steady_clock::now() + limit;
    while (std::chrono::steady_clock::now() < deadline) {
      if (predicate(daemon_->state())) {
        return true;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return false;
  }
  bool wait_for(capture::Phase phase) {
    return wait_until([phase](const capture::DaemonState& s) { return s.phase == phase; });
  }
  bool wait_for_commits(int n) {
    return wait_until([n](const capture::DaemonState& s) { return s.n_committed >= n; });
  }

  TemporaryFolder folder_;
  Rig rig_;
  session::DiskStorage disk_;
  std::shared_ptr<firmware_iface::FakeLight> light_ =
      std::make_shared<firmware_iface::FakeLight>();
  std::shared_ptr<capture::FakeCameraHands> hands_ =
      std::make_shared<capture::FakeCameraHands>();
  std::unique_ptr<capture::Daemon> daemon_;
};

}  // namespace haarlight::testing
