// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>

#include "capture/camera/camera.h"
#include "core/clock.h"

/// @file
/// The camera's newest frame for live viewers. While there was no request for two seconds
/// nothing is copied and no thread wakes. Otherwise a thread of its own copies one frame at a
/// time, at most five per second however many viewers there are, and at most a tenth of the
/// time: a frame of 100 MB less often. The camera's buffer is held for the duration of that one
/// copy.

namespace haarlight::capture {

/// A copy of a frame's active rows.
struct TappedFrame {
  std::uint64_t number = 0;    ///< 1, 2, ... of this tap; the camera's own count may restart
  std::uint64_t sequence = 0;  ///< the camera's
  std::int64_t arrived_ns = 0;
  Image<std::uint16_t> words;
};

class FrameTap {
 public:
  explicit FrameTap(Clock& clock = real_clock());
  ~FrameTap() { clock_.stop(thread_); }
  FrameTap(const FrameTap&) = delete;
  FrameTap& operator=(const FrameTap&) = delete;

  /// True when the next frame should be offered. Two loads; for the camera thread.
  [[nodiscard]] bool is_wanted(std::int64_t now_ns) const noexcept;
  /// Accepts a frame to copy. Never waits for a copy.
  /// @param active_rows  of its pixels; the embedded metadata rows below are not copied
  void offer(std::shared_ptr<const Frame> frame, int active_rows, std::int64_t now_ns);

  /// The newest copy from the camera's current stream; calling this keeps frames being copied.
  /// The first call after a pause waits up to 0.3 s for a fresh one. Thread-safe.
  [[nodiscard]] std::shared_ptr<const TappedFrame> newest();
  /// The camera stopped: the present copy is no longer live.
  void forget();
  /// Frames copied so far. Thread-safe.
  [[nodiscard]] std::uint64_t n_copied() const noexcept { return n_copied_; }

 private:
  void run(const std::stop_token& stop);

  Clock& clock_;
  std::atomic<std::int64_t> wanted_until_ns_{0};
  std::atomic<std::int64_t> next_ns_{0};  ///< earliest time; never while a frame waits or is
                                          ///< copied
  std::atomic<std::uint64_t> n_copied_{0};
  std::mutex mutex_;
  ClockCondition offered_{clock_};
  ClockCondition copied_{clock_};
  std::shared_ptr<const Frame> waiting_;
  int active_rows_ = 0;
  std::int64_t arrived_ns_ = 0;
  std::uint64_t stream_ = 0;  ///< incremented by forget: a copy in progress is no longer live
  std::shared_ptr<const TappedFrame> newest_;
  std::jthread thread_;  // last member: stops first
};

}  // namespace haarlight::capture
