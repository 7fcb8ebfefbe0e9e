// SPDX-License-Identifier: Apache-2.0
#include "core/report.h"

#include <cmath>

#include <nlohmann/json.hpp>
#include <sys/resource.h>

#include "haarlight/core/files.h"

namespace haarlight {

namespace {

using Json = nlohmann::ordered_json;

Json to_json_value(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json to_json_value(const ReportValue& value) {
  return std::visit(
      [](const auto& held) -> Json {
        using T = std::decay_t<decltype(held)>;
        if constexpr (std::is_same_v<T, double>) {
          return to_json_value(held);
        } else if constexpr (std::is_same_v<T, std::vector<double>>) {
          Json list = Json::array();
          for (const double x : held) {
            list.push_back(to_json_value(x));
          }
          return list;
        } else {
          return held;
        }
      },
      value);
}

}  // namespace

Report::Report(std::string command)
    : command_(std::move(command)), start_(std::chrono::steady_clock::now()) {}

void Report::add_input(const std::filesystem::path& path) { inputs_.push_back(path.string()); }
void Report::add_requested(std::string_view key, ReportValue value) {
  requested_.emplace_back(key, std::move(value));
}
void Report::add_achieved(std::string_view key, ReportValue value) {
  achieved_.emplace_back(key, std::move(value));
}
void Report::add_detail(std::string_view key, ReportValue value) {
  details_.emplace_back(key, std::move(value));
}

double Report::seconds() const {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
}

std::string Report::to_json() const {
  const auto object = [](const Entries& entries) {
    Json json = Json::object();
    for (const auto& [key, value] : entries) {
      json[key] = to_json_value(value);
    }
    return json;
  };
  Json json;
  json["command"] = command_;
  json["version"] = kVersion;
  json["inputs"] = inputs_;
  json["asked"] = object(requested_);
  json["reached"] = object(achieved_);
  json["seconds"] = seconds();
  json["bytes"] = bytes_;
  json["peak_memory_bytes"] = peak_memory_bytes();
  if (!details_.empty()) {
    json["details"] = object(details_);
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

void Report::write(const std::filesystem::path& path) const {
  if (!is_written_by_others_) {
    write_file_atomically(path, to_json());
  }
}

std::uint64_t peak_memory_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024U;
}

}  // namespace haarlight
