// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <deque>
#include <mutex>
#include <optional>
#include <stop_token>
#include <utility>

#include "core/clock.h"

/// @file
/// A bounded queue between two threads of the daemon.

namespace haarlight::capture {

/// Thread-safe; any number of threads at either end.
template <class T>
class WorkQueue {
 public:
  WorkQueue(std::size_t capacity, Clock& clock)
      : capacity_(capacity), filled_(clock), emptied_(clock) {}

  /// Queues nothing and returns false when full, apart from `spare` slots.
  [[nodiscard]] bool try_push(T item, std::size_t spare = 0) {
    {
      const std::lock_guard lock(mutex_);
      if (items_.size() + spare >= capacity_) {
        return false;
      }
      items_.push_back(std::move(item));
    }
    filled_.notify_one();
    return true;
  }

  /// Waits for space; false when stopped.
  [[nodiscard]] bool push(T item, const std::stop_token& stop) {
    {
      std::unique_lock lock(mutex_);
      if (!emptied_.wait(lock, stop, [this] { return items_.size() < capacity_; })) {
        return false;
      }
      items_.push_back(std::move(item));
    }
    filled_.notify_one();
    return true;
  }

  /// Nothing when the deadline passes or a stop is requested.
  [[nodiscard]] std::optional<T> pop(Clock::Time deadline, const std::stop_token& stop) {
    std::optional<T> item;
    {
      std::unique_lock lock(mutex_);
      if (!filled_.wait_until(lock, stop, deadline, [this] { return !items_.empty(); })) {
        return std::nullopt;
      }
      item.emplace(std::move(items_.front()));
      items_.pop_front();
    }
    emptied_.notify_one();
    return item;
  }

  /// Removes and returns every item that the predicate selects, in order.
  template <class Predicate>
  [[nodiscard]] std::deque<T> take_if(Predicate predicate) {
    std::deque<T> taken;
    {
      const std::lock_guard lock(mutex_);
      std::deque<T> kept;
      for (T& item : items_) {
        (predicate(item) ? taken : kept).push_back(std::move(item));
      }
      items_.swap(kept);
    }
    emptied_.notify_all();
    return taken;
  }

 private:
  std::size_t capacity_;
  std::mutex mutex_;
  ClockCondition filled_;
  ClockCondition emptied_;
  std::deque<T> items_;
};

}  // namespace haarlight::capture
