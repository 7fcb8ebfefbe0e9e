// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

/// @file
/// Speed-for-accuracy records, docs/reference/tradeoff.schema.json: one method under one set of
/// conditions, its cost and its error.

namespace haarlight {

struct TradeoffConditions {
  int threads = 1;
  int lights = 0;
  long long pixels = 0;
  int environments = 1;
  int repeats = 0;
  double coefficients_per_pixel = 0.0;  ///< 0: not sparse
  std::string command;
  /// Anything else the numbers depend on.
  std::vector<std::pair<std::string, std::variant<double, std::int64_t, std::string>>> more;
};

struct TradeoffRecord {
  std::string algorithm;   ///< implementation, for example haarlight, OpenBLAS
  std::string mode;        ///< method, for example dense half
  std::string error_norm;  ///< "relative L2", "bits that differ", "none" without a reference
  double error = 0.0;
  double seconds = 0.0;        ///< median
  double seconds_least = 0.0;  ///< of the repeats
  double seconds_most = 0.0;
  double bytes = 0.0;  ///< lower bound on memory traffic; sizes where `more` says bytes_are
  TradeoffConditions conditions;
};

/// Median, least and most of a method's repeats into its record.
/// @param seconds  one or more
void set_times(std::vector<double> seconds, TradeoffRecord& record);

/// Wall-clock seconds that the work takes.
[[nodiscard]] double seconds_of(const std::function<void()>& work);

/// The same of each work's runs, (works, repeats): all works in turn, then again, so
/// that what else the machine does meets all alike.
[[nodiscard]] std::vector<std::vector<double>> time_in_turn(
    std::span<const std::function<void()>> works, int repeats);

/// The records as JSON text, with the machine, its load and the compiler.
[[nodiscard]] std::string tradeoff_json(const std::vector<TradeoffRecord>& records);

}  // namespace haarlight
