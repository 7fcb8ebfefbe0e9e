// SPDX-License-Identifier: Apache-2.0
#include "core/tradeoff.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <fstream>
#include <thread>

#include <nlohmann/json.hpp>

#include "core/report.h"
#include "haarlight/core/error.h"

namespace haarlight {

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

void set_times(std::vector<double> seconds, TradeoffRecord& record) {
  HAARLIGHT_EXPECTS(!seconds.empty(), "a run");
  std::sort(seconds.begin(), seconds.end());
  record.seconds = seconds[seconds.size() / 2];
  record.seconds_least = seconds.front();
  record.seconds_most = seconds.back();
}

double seconds_of(const std::function<void()>& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
  return time.count();
}

std::vector<std::vector<double>> time_in_turn(std::span<const std::function<void()>> works,
                                              int repeats) {
  std::vector<std::vector<double>> seconds(works.size());
  for (int repeat = 0; repeat < repeats; ++repeat) {
    for (std::size_t i = 0; i < works.size(); ++i) {
      seconds[i].push_back(seconds_of(works[i]));
    }
  }
  return seconds;
}

std::string tradeoff_json(const std::vector<TradeoffRecord>& records) {
  std::array<double, 1> load{};
  (void)::getloadavg(load.data(), 1);
  const std::string machine = processor();
  nlohmann::json root = nlohmann::json::array();
  for (const TradeoffRecord& record : records) {
    const TradeoffConditions& at = record.conditions;
    nlohmann::json conditions = {{"machine", machine},
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
    for (const auto& [key, value] : at.more) {
      std::visit([&, name = key](const auto& held) { conditions[name] = held; }, value);
    }
    root.push_back({{"algorithm", record.algorithm},
                    {"mode", record.mode},
                    {"error_norm", record.error_norm},
                    {"error", record.error},
                    {"seconds", record.seconds},
                    {"bytes", record.bytes},
                    {"conditions", std::move(conditions)}});
  }
  return root.dump(1) + '\n';
}

}  // namespace haarlight
