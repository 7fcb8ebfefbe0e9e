// SPDX-License-Identifier: Apache-2.0
#include "core/clock.h"

#include <atomic>
#include <vector>

#include <gtest/gtest.h>

#include "core/virtual_clock.h"

namespace haarlight {
namespace {

using namespace std::chrono_literals;

TEST(RealClock, WaitsForItsTime) {
  Clock& clock = real_clock();
  const Clock::Time begin = clock.now();
  clock.sleep_for(2ms);
  EXPECT_GE(clock.now() - begin, 2ms);
  ClockCondition condition(clock);
  std::mutex mutex;
  std::unique_lock lock(mutex);
  const Clock::Time end = clock.now() + 2ms;
  EXPECT_FALSE(condition.wait_until(lock, {}, end, [] { return false; }));
  EXPECT_GE(clock.now(), end);
  EXPECT_TRUE(lock.owns_lock());
}

/// What both clocks promise of their conditions and threads.
class AnyClock : public ::testing::TestWithParam<bool> {
 protected:
  VirtualClock virtual_clock_;
  Clock& clock_ = GetParam() ? virtual_clock_ : real_clock();
};

TEST_P(AnyClock, ANotifiedThreadGoesOnAndAStoppedOneEnds) {
  std::mutex mutex;
  ClockCondition changed(clock_);
  ClockCondition answered(clock_);
  int n_sent = 0;
  int n_seen = 0;
  std::jthread thread = clock_.start([&](const std::stop_token& stop) {
    std::unique_lock lock(mutex);
    while (changed.wait(lock, stop, [&] { return n_sent > n_seen; })) {
      ++n_seen;
      answered.notify_all();
    }
  });
  for (int i = 1; i <= 100; ++i) {
    std::unique_lock lock(mutex);
    n_sent = i;
    changed.notify_one();
    EXPECT_TRUE(answered.wait(lock, {}, [&] { return n_seen == i; }));
  }
  clock_.stop(thread);
  EXPECT_FALSE(thread.joinable());
  EXPECT_EQ(n_seen, 100);
  clock_.stop(thread);  // a second time does nothing
}

INSTANTIATE_TEST_SUITE_P(Each, AnyClock, ::testing::Bool(), [](const auto& param_info) {
  return param_info.param ? "Virtual" : "Real";
});

TEST(VirtualClock, AnHourIsOverAtOnceAndExact) {
  VirtualClock clock;
  const VirtualClock::Member here(clock);
  const Clock::Time begin = clock.now();
  clock.sleep_for(1h);
  EXPECT_EQ(clock.now() - begin, 1h);
  clock.sleep_until(begin);  // the past
  EXPECT_EQ(clock.now() - begin, 1h);
}

TEST(VirtualClock, ThreadsWakeInTheOrderOfTheirTimes) {
  VirtualClock clock;
  std::mutex mutex;
  std::vector<std::chrono::nanoseconds> woken;
  {
    const VirtualClock::Member here(clock);
    const Clock::Time begin = clock.now();
    std::vector<std::jthread> threads;
    for (const auto period : {3ms, 5ms, 7ms}) {
      threads.push_back(clock.start([&, period](const std::stop_token& stop) {
        ClockCondition never(clock);
        std::mutex own;
        std::unique_lock lock(own);
        for (int i = 1; i <= 20; ++i) {
          (void)never.wait_until(lock, stop, begin + i * period, [] { return false; });
          const std::lock_guard guard(mutex);
          woken.push_back(clock.now() - begin);
          EXPECT_EQ(woken.back(), i * period);
        }
      }));
    }
    EXPECT_EQ(clock.now(), begin) << "nothing passes while this thread works";
    clock.sleep_until(begin + 1s);
    for (std::jthread& thread : threads) {
      clock.stop(thread);
    }
  }
  ASSERT_EQ(woken.size(), 60U);
  EXPECT_TRUE(std::is_sorted(woken.begin(), woken.end()));
}

// A thread that was notified has work to do: time may not pass before it has run.
TEST(VirtualClock, NoTimePassesBetweenANotificationAndItsThread) {
  VirtualClock clock;
  const VirtualClock::Member here(clock);
  std::mutex mutex;
  ClockCondition changed(clock);
  std::int64_t sent_ns = 0;
  int n_late = 0;
  int n_seen = 0;
  std::jthread thread = clock.start([&](const std::stop_token& stop) {
    std::unique_lock lock(mutex);
    while (changed.wait_until(lock, stop, Clock::kNever, [&] { return sent_ns != 0; })) {
      n_late += clock.now_ns() != sent_ns ? 1 : 0;
      ++n_seen;
      sent_ns = 0;
    }
  });
  for (int i = 0; i < 1000; ++i) {
    {
      const std::lock_guard lock(mutex);
      sent_ns = clock.now_ns();
    }
    changed.notify_one();
    clock.sleep_for(1us);
  }
  clock.stop(thread);
  EXPECT_EQ(n_seen, 1000);
  EXPECT_EQ(n_late, 0);
}

TEST(VirtualClock, AThreadOfNoClockMayWaitToo) {
  VirtualClock clock;
  const Clock::Time begin = clock.now();
  clock.sleep_for(1s);  // nobody else: time goes on
  EXPECT_EQ(clock.now() - begin, 1s);
  std::atomic<bool> is_woken{false};
  std::jthread stranger;
  {
    const VirtualClock::Member here(clock);
    stranger = std::jthread([&] {
      clock.sleep_until(begin + 3s);
      is_woken = true;
    });
    clock.sleep_until(begin + 2s);
    EXPECT_FALSE(is_woken);
  }
  stranger.join();
  EXPECT_GE(clock.now() - begin, 3s);
}

}  // namespace
}  // namespace haarlight
