// SPDX-License-Identifier: Apache-2.0
#include "core/virtual_clock.h"

#include <algorithm>
#include <utility>

namespace haarlight {

namespace {

/// The clock that the present thread is a member of.
thread_local const VirtualClock* clock_of_thread = nullptr;

}  // namespace

VirtualClock::Member::Member(VirtualClock& clock) : clock_(clock) {
  clock_of_thread = &clock;
  const std::lock_guard lock(clock_.mutex_);
  ++clock_.n_working_;
}

VirtualClock::Member::~Member() {
  clock_of_thread = nullptr;
  const std::lock_guard lock(clock_.mutex_);
  clock_.leave_locked();
}

Clock::Time VirtualClock::now() const {
  const std::lock_guard lock(mutex_);
  return now_;
}

void VirtualClock::sleep_until(Time time) {
  ClockCondition never(*this);
  std::mutex mutex;
  std::unique_lock lock(mutex);
  (void)wait(never, lock, {}, time, [] { return false; });
}

std::jthread VirtualClock::start(std::function<void(const std::stop_token&)> run) {
  {
    const std::lock_guard lock(mutex_);  // counted before it runs
    ++n_working_;
  }
  return std::jthread([this, run = std::move(run)](const std::stop_token& stop) {
    clock_of_thread = this;
    run(stop);
    const std::lock_guard lock(mutex_);
    leave_locked();
  });
}

void VirtualClock::stop(std::jthread& thread) {
  thread.request_stop();
  if (!thread.joinable()) {
    return;
  }
  const bool is_member = clock_of_thread == this;
  if (is_member) {
    const std::lock_guard lock(mutex_);
    leave_locked();
  }
  thread.join();
  if (is_member) {
    const std::lock_guard lock(mutex_);
    ++n_working_;
  }
}

bool VirtualClock::wait(ClockCondition& condition, std::unique_lock<std::mutex>& lock,
                        const std::stop_token& stop, Time deadline,
                        const std::function<bool()>& predicate) {
  const std::stop_callback on_stop(stop, [&] { wake(condition, Wake::all); });
  while (!predicate()) {
    Waiter waiter;
    waiter.condition = &condition;
    waiter.deadline = deadline;
    waiter.is_member = clock_of_thread == this;
    {
      // Listed before the caller's lock is released: who changes what the predicate sees finds
      // it. A stop that is requested after this look at it waits for mutex_ to wake us.
      std::unique_lock own(mutex_);
      if (stop.stop_requested() || deadline <= now_) {
        return predicate();
      }
      waiters_.push_back(&waiter);
      lock.unlock();
      if (waiter.is_member) {
        leave_locked();
      } else {
        advance_locked();
      }
      waiter.woken.wait(own, [&waiter] { return waiter.is_awake; });
    }
    lock.lock();
  }
  return true;
}

void VirtualClock::wake(ClockCondition& condition, Wake whom) {
  const std::lock_guard lock(mutex_);
  for (std::size_t i = 0; i < waiters_.size();) {
    if (waiters_[i]->condition != &condition) {
      ++i;
      continue;
    }
    wake_locked(i);
    if (whom == Wake::one) {
      return;
    }
  }
}

void VirtualClock::wake_locked(std::size_t waiter) {
  Waiter& awake = *waiters_[waiter];
  waiters_.erase(waiters_.begin() + static_cast<std::ptrdiff_t>(waiter));
  awake.is_awake = true;
  n_working_ += awake.is_member ? 1 : 0;  // it works from now on, though it may run later
  awake.woken.notify_one();
}

void VirtualClock::leave_locked() {
  --n_working_;
  advance_locked();
}

void VirtualClock::advance_locked() {
  while (n_working_ == 0) {
    Time next = kNever;
    for (const Waiter* waiter : waiters_) {
      next = std::min(next, waiter->deadline);
    }
    if (next == kNever) {
      return;  // all wait for somebody outside
    }
    now_ = std::max(now_, next);
    for (std::size_t i = 0; i < waiters_.size();) {
      if (waiters_[i]->deadline <= now_) {
        wake_locked(i);
      } else {
        ++i;
      }
    }
  }
}

}  // namespace haarlight
