#include "bench/relight/record.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <thread>

#include <nlohmann/json.hpp>

#include "core/error.h"
#include "core/report.h"

namespace haarlight::bench {

namespace {

std::string processor() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("model name")) {
      return line.substr(line.find(':') + 2);
    }
  }
  return "unknown";
}

}  // namespace

void set_times(std::vector<double> seconds, Record& record) {
  HAARLIGHT_EXPECTS(!seconds.empty(), "a run");
  std::sort(seconds.begin(), seconds.end());
  record.seconds = seconds[seconds.size() / 2];
  record.seconds_least = seconds.front();
  record.seconds_most = seconds.back();
}

void write_records(const std::vector<Record>& records, const std::filesystem::path& file) {
  std::array<double, 1> load{};
  (void)::getloadavg(load.data(), 1);
  nlohmann::json root = nlohmann::json::array();
  for (const Record& record : records) {
    const Conditions& at = record.conditions;
    nlohmann::json conditions = {{"machine", processor()},
                                 {"processors", std::thread::hardware_concurrency()},
                                 {"load", load[0]},
                                 {"compiler", "g++ " __VERSION__},
                                 {"version", std::string(kVersion)},
                                 {"command", at.command},
                                 {"threads", at.threads},
                                 {"lights", at.lights},
                                 {"pixels", at.pixels},
                                 {"environments", at.environments},
                                 {"repeats", at.repeats},
                                 {"seconds_least", record.seconds_least},
                                 {"seconds_most", record.seconds_most}};
    if (at.coefficients_per_pixel > 0.0) {
      conditions["coefficients_per_pixel"] = at.coefficients_per_pixel;
    }
    root.push_back({{"algorithm", record.algorithm},
                    {"mode", record.mode},
                    {"error_norm", record.error_norm},
                    {"error", record.error},
                    {"seconds", record.seconds},
                    {"bytes", record.bytes},
                    {"conditions", std::move(conditions)}});
  }
  std::ofstream(file) << root.dump(1) << '\n';
}

}  // namespace haarlight::bench
