// SPDX-License-Identifier: Apache-2.0
#include "capture/daemon/frame_tap.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <utility>

namespace haarlight::capture {

namespace {

constexpr std::int64_t kLookNs = 2'000'000'000;  // how long a request keeps frames being copied
constexpr std::int64_t kEveryNs = 200'000'000;
constexpr std::int64_t kPauseACopy = 9;  // idle nine parts for each part of copying
constexpr std::chrono::seconds kKept{10};
constexpr std::chrono::milliseconds kFirstWait{300};
constexpr std::int64_t kNotNow = std::numeric_limits<std::int64_t>::max();

}  // namespace

FrameTap::FrameTap(Clock& clock)
    : clock_(clock),
      thread_(clock_.start([this](const std::stop_token& stop) { run(stop); })) {}

bool FrameTap::is_wanted(std::int64_t now_ns) const noexcept {
  return now_ns < wanted_until_ns_.load(std::memory_order_relaxed) &&
         now_ns >= next_ns_.load(std::memory_order_relaxed);
}

void FrameTap::offer(std::shared_ptr<const Frame> frame, int active_rows, std::int64_t now_ns) {
  {
    const std::lock_guard lock(mutex_);
    waiting_ = std::move(frame);
    active_rows_ = active_rows;
    arrived_ns_ = now_ns;
    next_ns_ = kNotNow;
  }
  offered_.notify_one();
}

std::shared_ptr<const TappedFrame> FrameTap::newest() {
  const std::int64_t now_ns = clock_.now_ns();
  const bool is_first = wanted_until_ns_.exchange(now_ns + kLookNs) <= now_ns;
  std::unique_lock lock(mutex_);
  if (is_first) {
    const std::uint64_t n_before = n_copied_;
    copied_.wait_until(lock, {}, clock_.now() + kFirstWait,
                       [this, n_before] { return n_copied_ != n_before; });
  }
  return newest_;
}

void FrameTap::forget() {
  std::shared_ptr<const Frame> dropped;  // released outside the lock
  const std::lock_guard lock(mutex_);
  ++stream_;
  dropped = std::exchange(waiting_, nullptr);
  newest_ = nullptr;
  next_ns_ = 0;
}

void FrameTap::run(const std::stop_token& stop) {
  std::unique_lock lock(mutex_);
  while (!stop.stop_requested()) {
    const auto has_work = [this] { return waiting_ != nullptr; };
    if (newest_ == nullptr) {
      offered_.wait(lock, stop, has_work);
    } else if (!offered_.wait_until(lock, stop, clock_.now() + kKept, has_work) &&
               clock_.now_ns() >= wanted_until_ns_) {
      newest_ = nullptr;  // no memory is kept for viewers who left
    }
    std::shared_ptr<const Frame> frame = std::exchange(waiting_, nullptr);
    if (frame == nullptr) {
      continue;
    }
    const std::uint64_t stream = stream_;
    const int rows = active_rows_;
    const std::int64_t arrived_ns = arrived_ns_;
    lock.unlock();
    const std::int64_t begun_ns = clock_.now_ns();
    const ImageView<const std::uint16_t> pixels = frame->pixels();
    const int height = std::min(rows, pixels.height());
    const auto copy = std::make_shared<TappedFrame>();
    copy->words = Image<std::uint16_t>(height, pixels.width(), 1);
    for (int y = 0; y < height; ++y) {
      const auto row = pixels.row(y);
      std::copy(row.begin(), row.end(), copy->words.view().row(y).begin());
    }
    copy->sequence = frame->info().sequence;
    copy->arrived_ns = arrived_ns;
    frame.reset();  // the buffer goes back to the camera
    const std::int64_t now_ns = clock_.now_ns();
    lock.lock();
    copy->number = ++n_copied_;
    if (stream == stream_) {
      newest_ = copy;
      copied_.notify_all();
      next_ns_ = std::max(arrived_ns + kEveryNs, now_ns + kPauseACopy * (now_ns - begun_ns));
    }
  }
}

}  // namespace haarlight::capture
