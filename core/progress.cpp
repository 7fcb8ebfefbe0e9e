// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/progress.h"

#include <algorithm>
#include <cstdio>

#include <fmt/format.h>
#include <unistd.h>

namespace haarlight {

ProgressStyle choose_progress_style(bool quiet) {
  if (quiet) {
    return ProgressStyle::none;
  }
  return isatty(STDERR_FILENO) != 0 ? ProgressStyle::bar : ProgressStyle::lines;
}

Progress::Progress(std::string label, std::size_t total, ProgressStyle style)
    : label_(std::move(label)),
      total_(std::max<std::size_t>(total, 1)),
      style_(style),
      start_(std::chrono::steady_clock::now()),
      last_line_(start_) {}

Progress::~Progress() {
  if (style_ == ProgressStyle::bar && drawn_percent_ >= 0) {
    std::fputs("\n", stderr);
  }
}

void Progress::advance(std::size_t steps) {
  const std::scoped_lock lock(mutex_);
  done_ += steps;
  draw_locked();
}

void Progress::set_done(std::size_t done) {
  const std::scoped_lock lock(mutex_);
  done_ = done;
  draw_locked();
}

void Progress::draw_locked() {
  constexpr std::chrono::seconds kBetweenLines{5};
  const int percent = static_cast<int>(100 * std::min(done_, total_) / total_);
  const auto now = std::chrono::steady_clock::now();
  const bool is_due = style_ == ProgressStyle::lines ? now - last_line_ >= kBetweenLines
                                                     : percent != drawn_percent_;
  if (style_ == ProgressStyle::none || !is_due) {
    return;
  }
  drawn_percent_ = percent;
  last_line_ = now;
  const std::chrono::duration<double> spent = now - start_;
  const double left = done_ == 0 ? 0.0
                                 : spent.count() *
                                       static_cast<double>(total_ - std::min(done_, total_)) /
                                       static_cast<double>(done_);
  if (style_ == ProgressStyle::lines) {
    fmt::print(stderr, "{}: {} % ({} of {}), {:.0f} s left\n", label_, percent, done_, total_,
               left);
    return;
  }
  constexpr int kBarWidth = 30;
  const auto n_full = static_cast<std::size_t>(percent * kBarWidth / 100);
  fmt::print(stderr, "\r{} [{}{}] {:3d} % {:5.0f} s left", label_, std::string(n_full, '#'),
             std::string(kBarWidth - n_full, '.'), percent, left);
  std::fflush(stderr);
}

}  // namespace haarlight
