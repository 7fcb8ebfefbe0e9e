// SPDX-License-Identifier: Apache-2.0
#include "core/parallel.h"

#include <algorithm>

#include <tbb/global_control.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include "core/most_threads.h"
#include "haarlight/core/error.h"

#if defined(HAARLIGHT_TSAN)
#include <sanitizer/tsan_interface.h>
#endif

#if defined(HAARLIGHT_TSAN)
/// Embree's own tasks build its trees on oneTBB's threads: neither library is built with
/// ThreadSanitizer, so that it does not see what orders them. Called by its runtime.
extern "C" const char* __tsan_default_suppressions() { return "race:libembree\n"; }
#endif

namespace haarlight {

namespace {

/// oneTBB is built without ThreadSanitizer (and this file with it, see CMakeLists.txt), which
/// therefore does not see that a task starts after its caller and ends before the caller
/// continues. These annotations say so; races between two bodies remain visible to it.
class TaskOrder {
 public:
#if defined(HAARLIGHT_TSAN)
  void caller_starts() { __tsan_release(&start_); }
  void task_starts() { __tsan_acquire(&start_); }
  void task_ends() { __tsan_release(&end_); }
  void caller_goes_on() { __tsan_acquire(&end_); }

 private:
  char start_ = 0;
  char end_ = 0;
#else
  void caller_starts() {}
  void task_starts() {}
  void task_ends() {}
  void caller_goes_on() {}
#endif
};

/// The two ends of one task and of the whole call, whether by return or by exception.
class TaskMark {
 public:
  explicit TaskMark(TaskOrder& order) : order_(order) { order_.task_starts(); }
  ~TaskMark() { order_.task_ends(); }
  TaskMark(const TaskMark&) = delete;
  TaskMark& operator=(const TaskMark&) = delete;

 private:
  TaskOrder& order_;
};

class CallMark {
 public:
  explicit CallMark(TaskOrder& order) : order_(order) { order_.caller_starts(); }
  ~CallMark() { order_.caller_goes_on(); }
  CallMark(const CallMark&) = delete;
  CallMark& operator=(const CallMark&) = delete;

 private:
  TaskOrder& order_;
};

}  // namespace

void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
  HAARLIGHT_EXPECTS(grain > 0, "a positive grain");
  const std::size_t n_pieces = (count + grain - 1) / grain;
  if (n_pieces == 1) {
    body(0, count);
    return;
  }
  TaskOrder order;
  const CallMark call(order);
  tbb::parallel_for(
      tbb::blocked_range<std::size_t>(0, n_pieces, 1),
      [&](const tbb::blocked_range<std::size_t>& pieces) {
        const TaskMark task(order);
        for (std::size_t i = pieces.begin(); i != pieces.end(); ++i) {
          body(i * grain, std::min(count, (i + 1) * grain));
        }
      },
      tbb::simple_partitioner());
}

int most_threads() {
  const std::size_t allowed =
      tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism);
  return std::min(static_cast<int>(allowed), tbb::this_task_arena::max_concurrency());
}

struct ThreadLimit::Impl {
  tbb::global_control control;
};

ThreadLimit::ThreadLimit(int n_threads)
    : impl_(new Impl{tbb::global_control(tbb::global_control::max_allowed_parallelism,
                                         static_cast<std::size_t>(std::max(1, n_threads)))}) {}

ThreadLimit::~ThreadLimit() = default;

}  // namespace haarlight
