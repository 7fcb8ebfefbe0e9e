// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

/// @file
/// What a command did, as `--report FILE.json` stores it. Schema:
/// docs/reference/report.schema.json.

namespace haarlight {

inline constexpr std::string_view kVersion = HAARLIGHT_VERSION;

/// A number, a text, a boolean, or a list of numbers.
using ReportValue = std::variant<double, std::int64_t, bool, std::string, std::vector<double>>;

/// Keeps the order given; one command owns one Report. One thread.
class Report {
 public:
  explicit Report(std::string command);

  void add_input(const std::filesystem::path& path);
  void add_requested(std::string_view key, ReportValue value);
  void add_achieved(std::string_view key, ReportValue value);
  /// Bytes written as results.
  void set_bytes(std::uint64_t bytes) { bytes_ = bytes; }
  /// Anything else of interest; lands under "details".
  void add_detail(std::string_view key, ReportValue value);

  [[nodiscard]] double seconds() const;
  /// The report as JSON text; infinities and NaN become null.
  [[nodiscard]] std::string to_json() const;
  /// For one of several processes that do the same work: another one writes the file.
  void leave_to_others() { is_written_by_others_ = true; }
  /// @throws Error(io)
  void write(const std::filesystem::path& path) const;

 private:
  using Entries = std::vector<std::pair<std::string, ReportValue>>;
  std::string command_;
  std::vector<std::string> inputs_;
  Entries requested_;
  Entries achieved_;
  Entries details_;
  std::uint64_t bytes_ = 0;
  bool is_written_by_others_ = false;
  std::chrono::steady_clock::time_point start_;
};

/// Largest resident set of this process so far, bytes.
[[nodiscard]] std::uint64_t peak_memory_bytes();

}  // namespace haarlight
