#pragma once

#include <filesystem>
#include <string>
#include <vector>

/// @file
/// Speed-for-accuracy records, docs/tradeoff.schema.json: one method under one set of
/// conditions, what it cost and how far off it was.

namespace haarlight::bench {

struct Conditions {
  int threads = 1;
  int lights = 0;
  long long pixels = 0;
  int environments = 1;
  int repeats = 0;
  double coefficients_per_pixel = 0.0;  ///< 0: not sparse
  std::string command;
};

struct Record {
  std::string algorithm;   ///< whose, for example haarlight, OpenBLAS
  std::string mode;        ///< what, for example dense half
  std::string error_norm;  ///< "relative L2", "bits that differ", "none" where nothing is right
  double error = 0.0;
  double seconds = 0.0;        ///< median
  double seconds_least = 0.0;  ///< of the repeats
  double seconds_most = 0.0;
  double bytes = 0.0;  ///< moved to and from memory at least
  Conditions conditions;
};

/// Sorts `seconds` and puts median, least and most into the record.
void set_times(std::vector<double> seconds, Record& record);

/// With the machine, its load and the compiler.
void write_records(const std::vector<Record>& records, const std::filesystem::path& file);

}  // namespace haarlight::bench
