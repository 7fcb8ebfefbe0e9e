// SPDX-License-Identifier: Apache-2.0
#include "render/loop/run_progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <fmt/format.h>

namespace haarlight::render {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::seconds kBetweenLines{5};
constexpr std::chrono::milliseconds kBetweenChanges{200};

}  // namespace

std::optional<double> seconds_left(const RunState& state) {
  double left = state.most_seconds - state.seconds;
  const double made = state.samples - state.first_samples;
  const auto limit = [&](const std::optional<double>& samples) {
    if (samples && made > 0.0) {
      left = std::min(left, state.seconds * (*samples - state.samples) / made);
    }
  };
  limit(state.most_samples);
  limit(state.samples_foreseen);
  return std::isfinite(left) ? std::optional(std::max(0.0, left)) : std::nullopt;
}

std::string progress_words(const RunState& state) {
  std::string words = fmt::format("{:.1f}", state.samples);
  if (state.most_samples) {
    words += fmt::format(" of {:.0f}", *state.most_samples);
  }
  words += " samples per pixel";
  if (state.requested_error) {
    words +=
        state.error && std::isfinite(*state.error)
            ? fmt::format(", error {:.2g} (requested {:.2g})", *state.error,
                          *state.requested_error)
            : fmt::format(", error not known yet (requested {:.2g})", *state.requested_error);
  }
  if (const std::optional<double> left = seconds_left(state)) {
    words += fmt::format(", {:.0f} s left", *left);
  }
  return words;
}

RunProgress::RunProgress(ProgressStyle style) : style_(style), told_(Clock::now()) {}

RunProgress::~RunProgress() {
  if (!drawn_.empty()) {
    std::fputs("\n", stderr);
  }
}

void RunProgress::tell(const RunState& state) {
  if (style_ == ProgressStyle::none) {
    return;
  }
  const std::scoped_lock lock(mutex_);
  const auto now = Clock::now();
  if (style_ == ProgressStyle::lines) {
    if (now - told_ >= kBetweenLines) {
      told_ = now;
      fmt::print(stderr, "render: {}\n", progress_words(state));
    }
    return;
  }
  if (!drawn_.empty() && now - told_ < kBetweenChanges) {
    return;
  }
  told_ = now;
  const std::string line = "render: " + progress_words(state);
  // Spaces hide what is left of a longer one.
  fmt::print(stderr, "\r{:{}}", line, std::max(line.size(), drawn_.size()));
  std::fflush(stderr);
  drawn_ = line;
}

}  // namespace haarlight::render
