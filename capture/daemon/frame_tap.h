// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>

#include "capture/camera/camera.h"

/// @file
/// The camera's newest frame for people who look. While nobody has asked for two seconds
/// nothing is copied and no thread wakes. While somebody does, one frame at a time is copied by
/// a thread of its own, at most five a second whatever the number of those who look, and not
/// more than a tenth of the time: a frame of 100 MB less often. The camera's buffer is held for
/// the length of that one copy.

namespace haarlight {

/// A copy of a frame's active rows.
struct TappedFrame {
  std::uint64_t number = 0;  ///< 1, 2, ... of this tap; the camera's own count may start again
  std::uint64_t sequence = 0;  ///< the camera's
  std::int64_t arrived_ns = 0;
  Image<std::uint16_t> words;
};

class FrameTap {
 public:
  FrameTap();
  ~FrameTap() = default;
  FrameTap(const FrameTap&) = delete;
  FrameTap& operator=(const FrameTap&) = delete;

  /// True when the next frame is wanted. Two loads; for the camera's thread.
  [[nodiscard]] bool is_wanted(std::int64_t now_ns) const noexcept;
  /// Takes the frame to be copied. Never waits for a copy.
  /// @param active_rows  of its pixels; the tag rows below them are nobody's concern
  void offer(std::shared_ptr<const Frame> frame, int active_rows, std::int64_t now_ns);

  /// The newest copy of the camera's present stream; asking is what keeps frames being copied.
  /// Who asks after nobody did waits up to 0.3 s for a fresh one. Thread-safe.
  [[nodiscard]] std::shared_ptr<const TappedFrame> newest();
  /// The camera stopped: what there is is no longer live.
  void forget();
  /// Frames copied so far. Thread-safe.
  [[nodiscard]] std::uint64_t n_copied() const noexcept { return n_copied_; }

 private:
  void run(const std::stop_token& stop);

  std::atomic<std::int64_t> wanted_until_ns_{0};
  std::atomic<std::int64_t> next_ns_{0};  ///< not before; never while one waits or is copied
  std::atomic<std::uint64_t> n_copied_{0};
  std::mutex mutex_;
  std::condition_variable_any offered_;
  std::condition_variable_any copied_;
  std::shared_ptr<const Frame> waiting_;
  int active_rows_ = 0;
  std::int64_t arrived_ns_ = 0;
  std::uint64_t stream_ = 0;  ///< raised by forget: a copy under way is no longer live
  std::shared_ptr<const TappedFrame> newest_;
  std::jthread thread_;  // last: stops first
};

}  // namespace haarlight
