// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <ctime>

/// @file
/// What work costs on a machine that does other work, too.

namespace haarlight {

/// CPU seconds of the calling thread so far.
[[nodiscard]] inline double thread_cpu_seconds() {
  timespec used{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
  return static_cast<double>(used.tv_sec) + 1e-9 * static_cast<double>(used.tv_nsec);
}

/// CPU seconds of all threads of this program so far.
[[nodiscard]] inline double process_cpu_seconds() {
  timespec used{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &used);
  return static_cast<double>(used.tv_sec) + 1e-9 * static_cast<double>(used.tv_nsec);
}

}  // namespace haarlight
