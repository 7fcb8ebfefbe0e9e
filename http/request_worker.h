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
#include <vector>

#include "core/clock.h"
#include "http/site.h"

/// @file
/// Threads for requests that would otherwise keep the HTTP thread from all-off, behind a
/// bounded queue; each request is answered exactly once, whatever happens to it.

namespace haarlight::http {

/// Thread-safe.
class RequestWorker {
 public:
  struct Job {
    /// A newer job replaces a waiting one with the same key, which is answered 409; empty:
    /// never.
    std::string key;
    std::function<HttpResponse()> answer;    ///< throws nothing; called on the worker's thread
    std::function<void(HttpResponse)> done;  ///< called once, on the worker's or a caller's
  };

  /// @param max_waiting  jobs in addition to those in progress
  /// @param patience     a job that waited longer, by the clock, is answered 503: its client is
  ///                     gone
  /// @param n_threads    jobs in progress at once
  RequestWorker(std::size_t max_waiting, std::chrono::milliseconds patience, const Clock& clock,
                int n_threads = 1);
  ~RequestWorker();
  RequestWorker(const RequestWorker&) = delete;
  RequestWorker& operator=(const RequestWorker&) = delete;

  /// Always calls `done` eventually; at once with 503 when the queue is full or closed.
  void push(Job job);
  /// Answers waiting jobs with 503, finishes the one in progress, accepts no more.
  void close();

 private:
  struct Waiting {
    Job job;
    Clock::Time since;
  };
  void run(const std::stop_token& stop);

  std::size_t max_waiting_;
  std::chrono::milliseconds patience_;
  const Clock& clock_;
  std::mutex mutex_;
  std::condition_variable_any filled_;
  std::deque<Waiting> waiting_;
  bool is_closed_ = false;
  std::vector<std::jthread> threads_;  // last member: stops first
};

}  // namespace haarlight::http
