// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <string_view>

#include "core/clock.h"

/// @file
/// How the watchdog knows that a thread makes progress: each records when it begins and ends a
/// call that might hang. A thread that waits for work is healthy.

namespace haarlight {

/// One per thread; read by the watchdog. Thread-safe.
class ThreadPulse {
 public:
  ThreadPulse(std::string_view name, const Clock& clock) : name_(name), clock_(clock) {}

  /// Marks the thread busy until the end of the scope.
  class Busy {
   public:
    explicit Busy(ThreadPulse& pulse) : pulse_(pulse) {
      pulse_.since_ns_ = pulse_.clock_.now_ns();
    }
    ~Busy() { pulse_.since_ns_ = 0; }
    Busy(const Busy&) = delete;
    Busy& operator=(const Busy&) = delete;

   private:
    ThreadPulse& pulse_;
  };

  /// How long the current call has lasted; 0 when waiting for work.
  [[nodiscard]] std::chrono::nanoseconds busy_for() const {
    const std::int64_t since = since_ns_;
    return std::chrono::nanoseconds(since == 0 ? 0 : clock_.now_ns() - since);
  }
  [[nodiscard]] std::string_view name() const noexcept { return name_; }

 private:
  std::string_view name_;
  const Clock& clock_;
  std::atomic<std::int64_t> since_ns_{0};
};

}  // namespace haarlight
