// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/camera_thread.h"

#include <atomic>
#include <condition_variable>

#include <gtest/gtest.h>

namespace haarlight::capture {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// What a test sees of the camera.
struct Seen {
  std::mutex mutex;
  std::condition_variable changed;
  int n_polls = 0;       ///< calls of next() without a wait, after the start
  int n_waits = 0;       ///< with one
  int n_idle_waits = 0;  ///< with one, and no frame to come
  int n_triggers = 0;

  template <class Predicate>
  bool wait(Predicate predicate) {
    std::unique_lock lock(mutex);
    return changed.wait_for(lock, 20s, predicate);
  }
};

/// One frame for each trigger; tells how it was waited for.
class TriggeredCamera final : public Camera {
 public:
  explicit TriggeredCamera(std::shared_ptr<Seen> seen) : seen_(std::move(seen)) {}
  Result<CameraSetup> start(const CameraSpec& spec) override {
    return CameraSetup{.width = spec.frame_width,
                       .height = spec.frame_height,
                       .n_buffers = 4,
                       .fps = spec.fps,
                       .exposure_us = spec.exposure_us,
                       .identity = "triggered"};
  }
  Result<Frame> next(Clock::time_point deadline) override {
    const bool is_wait = deadline > Clock::now();
    {
      const std::lock_guard lock(seen_->mutex);
      seen_->n_polls += is_wait ? 0 : 1;
      seen_->n_waits += is_wait ? 1 : 0;
      seen_->n_idle_waits += is_wait && !is_due_ && !is_free_ ? 1 : 0;
    }
    seen_->changed.notify_all();
    if (is_due_ || is_free_) {
      is_due_ = false;
      return Frame({.sequence = n_++, .timestamp_ns = 1, .flags = kFrameMonotonic}, {}, {});
    }
    std::this_thread::sleep_until(deadline);
    return fail(Errc::timeout, "none");
  }
  Result<double> set_exposure(double exposure_us) override { return exposure_us; }
  Result<void> set_trigger(TriggerSource source) override {
    is_free_ = source == TriggerSource::free;
    return {};
  }
  Result<void> trigger() override {
    is_due_ = true;
    const std::lock_guard lock(seen_->mutex);
    ++seen_->n_triggers;
    return {};
  }
  void stop() noexcept override {}

 private:
  std::shared_ptr<Seen> seen_;
  bool is_due_ = false;
  bool is_free_ = true;
  std::uint64_t n_ = 0;
};

TEST(CameraThread, ATriggerIsNotKeptWaitingByASilentCamera) {
  const auto seen = std::make_shared<Seen>();
  FrameStore store;
  std::atomic<int> n_frames{0};
  CameraSpec spec;
  spec.frame_width = 4;
  spec.frame_height = spec.active_rows = 4;
  spec.exposure_us = 1000.0;
  CameraThread thread(std::make_unique<TriggeredCamera>(seen), spec, store,
                      [&](const EventBody& body) {
                        if (const auto* frame = std::get_if<event::FrameArrived>(&body)) {
                          store.drop(frame->frame);
                          ++n_frames;
                          seen->changed.notify_all();
                        }
                      });
  thread.post(action::StartCamera{1, 1000.0, SyncMode::light_leads});
  // Silent: it looks at the camera from time to time and never waits for it.
  ASSERT_TRUE(seen->wait([&] { return seen->n_polls >= 3; }));
  for (int i = 1; i <= 5; ++i) {
    thread.post(action::TriggerCamera{});
    ASSERT_TRUE(seen->wait([&] { return n_frames == i; })) << i;
  }
  const std::lock_guard lock(seen->mutex);
  EXPECT_EQ(seen->n_triggers, 5);
  EXPECT_EQ(seen->n_idle_waits, 0);
}

TEST(CameraThread, ACameraThatRunsFreelyIsWaitedFor) {
  const auto seen = std::make_shared<Seen>();
  FrameStore store;
  CameraThread thread(std::make_unique<TriggeredCamera>(seen), CameraSpec{}, store,
                      [&](const EventBody& body) {
                        if (const auto* frame = std::get_if<event::FrameArrived>(&body)) {
                          store.drop(frame->frame);
                        }
                      });
  thread.post(action::StartCamera{1, 1000.0, SyncMode::free_run});
  ASSERT_TRUE(seen->wait([&] { return seen->n_waits >= 3; }));
  const std::lock_guard lock(seen->mutex);
  EXPECT_EQ(seen->n_polls, 0);
}

}  // namespace
}  // namespace haarlight::capture
