// SPDX-License-Identifier: Apache-2.0
#include "http/request_worker.h"

#include <algorithm>
#include <optional>
#include <utility>

#include <sys/resource.h>

namespace haarlight::http {
namespace {

constexpr int kNice = 10;  // frames, lights and the HTTP thread have priority

HttpResponse overloaded() {
  HttpResponse response =
      error_response(503, "too many requests at once", "the request", "try again in a second");
  response.headers["Retry-After"] = "1";
  return response;
}

}  // namespace

RequestWorker::RequestWorker(std::size_t max_waiting, std::chrono::milliseconds patience,
                             const Clock& clock, int n_threads)
    : max_waiting_(max_waiting), patience_(patience), clock_(clock) {
  HAARLIGHT_EXPECTS(n_threads > 0, "a thread at least");
  for (int i = 0; i < n_threads; ++i) {
    threads_.emplace_back([this](const std::stop_token& stop) { run(stop); });
  }
}

RequestWorker::~RequestWorker() { close(); }

void RequestWorker::push(Job job) {
  std::optional<Job> superseded;
  std::optional<Job> refused;
  {
    const std::lock_guard lock(mutex_);
    const auto older =
        job.key.empty() ? waiting_.end()
                        : std::find_if(waiting_.begin(), waiting_.end(),
                                       [&](const Waiting& w) { return w.job.key == job.key; });
    if (!is_closed_ && older != waiting_.end()) {
      superseded = std::exchange(older->job, std::move(job));
      older->since = clock_.now();
    } else if (!is_closed_ && waiting_.size() < max_waiting_) {
      waiting_.push_back({std::move(job), clock_.now()});
    } else {
      refused = std::move(job);
    }
  }
  filled_.notify_one();
  if (superseded) {
    superseded->done(error_response(409, "a newer request of the same client stands for this",
                                    "the request", "wait for the newer one's answer"));
  }
  if (refused) {
    refused->done(overloaded());
  }
}

void RequestWorker::close() {
  {
    const std::lock_guard lock(mutex_);
    is_closed_ = true;
  }
  for (std::jthread& thread : threads_) {
    thread.request_stop();
  }
  threads_.clear();  // joins them
  std::deque<Waiting> left;
  {
    const std::lock_guard lock(mutex_);
    left.swap(waiting_);
  }
  for (const Waiting& one : left) {
    one.job.done(overloaded());
  }
}

void RequestWorker::run(const std::stop_token& stop) {
  (void)::setpriority(PRIO_PROCESS, 0, kNice);  // Linux: of this thread alone
  while (!stop.stop_requested()) {
    std::optional<Waiting> next;
    {
      std::unique_lock lock(mutex_);
      if (!filled_.wait(lock, stop, [this] { return !waiting_.empty(); }) ||
          stop.stop_requested()) {
        return;
      }
      next.emplace(std::move(waiting_.front()));
      waiting_.pop_front();
    }
    next->job.done(clock_.now() - next->since > patience_ ? overloaded() : next->job.answer());
  }
}

}  // namespace haarlight::http
