// SPDX-License-Identifier: Apache-2.0
#include "bench/relight/record.h"

#include <algorithm>
#include <fstream>

#include "haarlight/core/error.h"

namespace haarlight::bench {

void set_times(std::vector<double> seconds, Record& record) {
  HAARLIGHT_EXPECTS(!seconds.empty(), "a run");
  std::sort(seconds.begin(), seconds.end());
  record.seconds = seconds[seconds.size() / 2];
  record.seconds_least = seconds.front();
  record.seconds_most = seconds.back();
}

void write_records(const std::vector<Record>& records, const std::filesystem::path& file) {
  std::ofstream(file) << tradeoff_json(records);
}

}  // namespace haarlight::bench
