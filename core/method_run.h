// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/method.h"
#include "core/tradeoff.h"

/// @file
/// Runs a method under each of its settings: times, errors, and whether the errors fall.

namespace haarlight {

struct MethodRunOptions {
  MethodSize size = MethodSize::small;
  int repeats = 5;      ///< timed runs of each setting, after one that is not
  int threads = 1;      ///< for the records
  std::string command;  ///< for the records
};

struct MethodRun {
  std::vector<TradeoffRecord> records;  ///< one per setting, from fast to exact
  /// Settings whose error is larger than a faster one's, and larger than
  /// MethodWords::exact_error, below which errors are rounding: one sentence each.
  std::vector<std::string> grown;
  /// The last setting's error is within MethodWords::exact_error. NaN is not.
  bool is_exact = false;
};

/// The settings in turn, as often as asked for, so that other work on the machine meets all
/// alike.
[[nodiscard]] MethodRun run_method(const Method& method, const MethodRunOptions& options);

/// The methods as a table in Markdown, sorted as given.
[[nodiscard]] std::string methods_markdown(std::span<const Method> methods);

/// What the records say, a row each, as a table in Markdown.
[[nodiscard]] std::string records_markdown(std::span<const TradeoffRecord> records);

}  // namespace haarlight
