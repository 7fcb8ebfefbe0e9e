// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "http/site.h"

/// @file
/// A thread that answers what would keep the HTTP thread from all-off: a bounded queue in front
/// of it, and each request is answered once, whatever happens to it.

namespace haarlight {

/// Thread-safe.
class RequestWorker {
 public:
  struct Job {
    /// A newer job with the same key takes the place of one that still waits, which is answered
    /// 409; empty: none does.
    std::string key;
    std::function<HttpResponse()> answer;    ///< throws nothing; called on the worker's thread
    std::function<void(HttpResponse)> done;  ///< called once, on the worker's or a caller's
  };

  /// @param max_waiting  jobs beside the one at work
  /// @param patience     a job that waited longer is answered 503: who asked is gone
  RequestWorker(std::size_t max_waiting, std::chrono::milliseconds patience);
  ~RequestWorker();
  RequestWorker(const RequestWorker&) = delete;
  RequestWorker& operator=(const RequestWorker&) = delete;

  /// Calls `done` sooner or later; at once with 503 when the queue is full or closed.
  void push(Job job);
  /// Answers what waits with 503, ends the one at work, takes no more.
  void close();

 private:
  using Clock = std::chrono::steady_clock;
  struct Waiting {
    Job job;
    Clock::time_point since;
  };
  void run(const std::stop_token& stop);

  std::size_t max_waiting_;
  std::chrono::milliseconds patience_;
  std::mutex mutex_;
  std::condition_variable_any filled_;
  std::deque<Waiting> waiting_;
  bool is_closed_ = false;
  std::jthread thread_;  // last: stops first
};

}  // namespace haarlight
