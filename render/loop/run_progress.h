// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <limits>
#include <mutex>
#include <optional>
#include <string>

#include "haarlight/core/progress.h"

/// @file
/// What a render tells while it works: samples, error, time left, as far as they are known.

namespace haarlight::render {

/// How far a render is. Samples are of each pixel, in the mean over the picture.
struct RunState {
  double first_samples = 0.0;  ///< when it began: of a render that goes on
  double samples = 0.0;
  std::optional<double> most_samples;      ///< that were requested
  std::optional<double> requested_error;   ///< relative L2
  std::optional<double> error;             ///< when it was last looked at
  std::optional<double> samples_foreseen;  ///< for the requested error, by the last look
  double seconds = 0.0;                    ///< spent
  double most_seconds = std::numeric_limits<double>::infinity();
};

/// Until the first of its ends; nothing while none can be foreseen.
[[nodiscard]] std::optional<double> seconds_left(const RunState& state);

/// "12.5 of 64 samples per pixel, error 0.021 (requested 0.01), 30 s left"
[[nodiscard]] std::string progress_words(const RunState& state);

/// Writes it to the standard error: a line that changes on terminals, elsewhere one every five
/// seconds. Thread-safe.
class RunProgress {
 public:
  explicit RunProgress(ProgressStyle style);
  /// Ends the line.
  ~RunProgress();
  RunProgress(const RunProgress&) = delete;
  RunProgress& operator=(const RunProgress&) = delete;

  void tell(const RunState& state);

 private:
  std::mutex mutex_;
  ProgressStyle style_;
  std::chrono::steady_clock::time_point told_;
  std::string drawn_;  ///< on the terminal
};

}  // namespace haarlight::render
