// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

/// @file
/// Data-parallel loops over oneTBB, behind one .cpp (its own target: the daemon does not link
/// it). A body must write only what its own range owns; results then do not depend on the
/// number of threads.

namespace haarlight {

/// Calls `body(begin, end)` over [0, count) in chunks of at most `grain`; chunk borders are
/// multiples of `grain` whatever the number of threads. Exceptions thrown by a body reach the
/// caller.
void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t begin, std::size_t end)>& body);

/// Caps the threads of every later parallel_for during its lifetime; only main owns one.
class ThreadLimit {
 public:
  explicit ThreadLimit(int n_threads);
  ~ThreadLimit();
  ThreadLimit(const ThreadLimit&) = delete;
  ThreadLimit& operator=(const ThreadLimit&) = delete;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight
