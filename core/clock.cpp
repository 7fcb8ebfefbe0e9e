// SPDX-License-Identifier: Apache-2.0
#include "core/clock.h"

#include <utility>

namespace haarlight {

namespace {

/// libstdc++'s steady_clock is CLOCK_MONOTONIC.
class RealClock final : public Clock {
 public:
  [[nodiscard]] Time now() const override { return std::chrono::steady_clock::now(); }
  void sleep_until(Time time) override { std::this_thread::sleep_until(time); }
  [[nodiscard]] std::jthread start(std::function<void(const std::stop_token&)> run) override {
    return std::jthread(std::move(run));
  }
  void stop(std::jthread& thread) override {
    thread.request_stop();
    if (thread.joinable()) {
      thread.join();
    }
  }

 private:
  bool wait(ClockCondition& condition, std::unique_lock<std::mutex>& lock,
            const std::stop_token& stop, Time deadline,
            const std::function<bool()>& predicate) override {
    std::condition_variable_any& system = system_condition(condition);
    return deadline == kNever ? system.wait(lock, stop, predicate)
                              : system.wait_until(lock, stop, deadline, predicate);
  }
  void wake(ClockCondition& condition, Wake whom) override {
    std::condition_variable_any& system = system_condition(condition);
    whom == Wake::one ? system.notify_one() : system.notify_all();
  }
};

}  // namespace

std::condition_variable_any& Clock::system_condition(ClockCondition& condition) {
  return condition.system_;
}

Clock& real_clock() {
  static RealClock clock;
  return clock;
}

}  // namespace haarlight
