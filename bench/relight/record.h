// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <vector>

#include "core/tradeoff.h"

/// @file
/// Records of benchmarks (core/tradeoff.h): times of repeats, and the file.

namespace haarlight::bench {

using Conditions = TradeoffConditions;
using Record = TradeoffRecord;

/// Sorts `seconds` and puts median, least and most into the record.
void set_times(std::vector<double> seconds, Record& record);

/// With the machine, its load and the compiler.
void write_records(const std::vector<Record>& records, const std::filesystem::path& file);

}  // namespace haarlight::bench
