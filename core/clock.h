// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <stop_token>
#include <thread>

/// @file
/// Time, and waiting by it. Threads that take their time from a Clock run in production by
/// CLOCK_MONOTONIC and in tests by a virtual time (core/virtual_clock.h), where a promise in
/// milliseconds is exact and costs none.

namespace haarlight {

class ClockCondition;

/// Thread-safe. Outlives whatever uses it.
class Clock {
 public:
  using Time = std::chrono::steady_clock::time_point;
  static constexpr Time kNever = Time::max();

  Clock() = default;
  virtual ~Clock() = default;
  Clock(const Clock&) = delete;
  Clock& operator=(const Clock&) = delete;

  [[nodiscard]] virtual Time now() const = 0;
  /// The same in nanoseconds.
  [[nodiscard]] std::int64_t now_ns() const { return now().time_since_epoch() / kNanosecond; }

  virtual void sleep_until(Time time) = 0;
  void sleep_for(std::chrono::nanoseconds length) { sleep_until(now() + length); }

  /// Starts a thread that waits for nothing but this clock and its conditions (and, briefly, for
  /// locks and the disk): virtual time stands still while it works.
  [[nodiscard]] virtual std::jthread start(std::function<void(const std::stop_token&)> run) = 0;
  /// Requests that one of its threads stops, and joins it; nothing where there is none.
  virtual void stop(std::jthread& thread) = 0;

 protected:
  enum class Wake { one, all };
  /// What a real clock waits on.
  [[nodiscard]] static std::condition_variable_any& system_condition(ClockCondition& condition);

 private:
  friend class ClockCondition;
  static constexpr std::chrono::nanoseconds kNanosecond{1};

  /// See ClockCondition::wait_until.
  virtual bool wait(ClockCondition& condition, std::unique_lock<std::mutex>& lock,
                    const std::stop_token& stop, Time deadline,
                    const std::function<bool()>& predicate) = 0;
  virtual void wake(ClockCondition& condition, Wake whom) = 0;
};

/// A condition variable whose deadlines are those of a clock.
class ClockCondition {
 public:
  explicit ClockCondition(Clock& clock) : clock_(clock) {}

  /// Waits until the predicate holds, the time has come or a stop is requested.
  /// @param lock  held by the caller; also while the predicate is evaluated
  /// @return what the predicate says last
  bool wait_until(std::unique_lock<std::mutex>& lock, const std::stop_token& stop,
                  Clock::Time deadline, const std::function<bool()>& predicate) {
    return clock_.wait(*this, lock, stop, deadline, predicate);
  }
  bool wait(std::unique_lock<std::mutex>& lock, const std::stop_token& stop,
            const std::function<bool()>& predicate) {
    return clock_.wait(*this, lock, stop, Clock::kNever, predicate);
  }
  void notify_one() { clock_.wake(*this, Clock::Wake::one); }
  void notify_all() { clock_.wake(*this, Clock::Wake::all); }

 private:
  friend class Clock;
  Clock& clock_;
  std::condition_variable_any system_;  ///< unused under virtual time
};

/// CLOCK_MONOTONIC.
[[nodiscard]] Clock& real_clock();

}  // namespace haarlight
