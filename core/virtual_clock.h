// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include "core/clock.h"

/// @file
/// The clock of tests. Its time stands still while any of its threads works, and when all of
/// them wait it jumps to the next moment one of them waits for: an hour of waiting costs
/// nothing, and no time passes because the machine is slow. The predicate of a wait does not call
/// the clock.

namespace haarlight {

class VirtualClock final : public Clock {
 public:
  /// Counts the calling thread as one of the clock's while it exists: time stands still unless
  /// that thread, too, waits by the clock. It must not wait for a thread of the clock in any
  /// other way, which would be for ever.
  class Member {
   public:
    explicit Member(VirtualClock& clock);
    ~Member();
    Member(const Member&) = delete;
    Member& operator=(const Member&) = delete;

   private:
    VirtualClock& clock_;
  };

  [[nodiscard]] Time now() const override;
  void sleep_until(Time time) override;
  [[nodiscard]] std::jthread start(std::function<void(const std::stop_token&)> run) override;
  /// Time goes on while a member waits here, though not before the stop is requested.
  void stop(std::jthread& thread) override;

 private:
  struct Waiter {
    const ClockCondition* condition = nullptr;
    Time deadline;
    bool is_member = false;  ///< others may wait too, but time does not wait for them
    bool is_awake = false;
    std::condition_variable woken;
  };

  bool wait(ClockCondition& condition, std::unique_lock<std::mutex>& lock,
            const std::stop_token& stop, Time deadline,
            const std::function<bool()>& predicate) override;
  void wake(ClockCondition& condition, Wake whom) override;

  // mutex_ is held, which is the innermost lock of all.
  void wake_locked(std::size_t waiter);
  void leave_locked();
  void advance_locked();

  mutable std::mutex mutex_;
  Time now_{std::chrono::hours(1)};
  int n_working_ = 0;             ///< members that do not wait
  std::vector<Waiter*> waiters_;  ///< in the order in which they came
};

}  // namespace haarlight
