// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <mutex>
#include <string>

/// @file
/// Progress of a long job: a bar on a terminal, a line every five seconds elsewhere, nothing
/// when quiet. Written to stderr.

namespace haarlight {

enum class ProgressStyle { bar, lines, none };

/// `bar` when stderr is a terminal, else `lines`; `none` when quiet.
[[nodiscard]] ProgressStyle choose_progress_style(bool quiet);

/// Thread-safe. The destructor ends the bar's line.
class Progress {
 public:
  Progress(std::string label, std::size_t total, ProgressStyle style);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void advance(std::size_t steps = 1);
  /// Sets the number done, when the source keeps its own count.
  void set_done(std::size_t done);

 private:
  void draw_locked();

  std::mutex mutex_;
  std::string label_;
  std::size_t total_;
  std::size_t done_ = 0;
  int drawn_percent_ = -1;
  ProgressStyle style_;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_line_;
};

}  // namespace haarlight
