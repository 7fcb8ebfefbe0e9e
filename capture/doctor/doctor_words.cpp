// SPDX-License-Identifier: Apache-2.0
#include "capture/doctor/doctor_words.h"

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace haarlight::capture {

std::string doctor_text(const std::vector<DoctorLine>& lines) {
  std::string text;
  std::size_t width = 0;
  for (const DoctorLine& line : lines) {
    width = std::max(width, line.subject.size());
  }
  for (const DoctorLine& line : lines) {
    text += fmt::format("{:<7}  {:<{}}  {}\n", to_string(line.finding), line.subject, width,
                        line.found);
    if (line.finding != Finding::good) {
      text += fmt::format("{:<7}  {:<{}}  expected: {}\n", "", "", width, line.expected);
      text += fmt::format("{:<7}  {:<{}}  hint: {}\n", "", "", width, line.hint.text());
    }
  }
  return text;
}

std::string doctor_json(const std::vector<DoctorLine>& lines) {
  nlohmann::json json = nlohmann::json::array();
  for (const DoctorLine& line : lines) {
    json.push_back({{"subject", line.subject},
                    {"finding", to_string(line.finding)},
                    {"expected", line.expected},
                    {"found", line.found},
                    {"cure", line.hint.text()}});
  }
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
}

void add_to_report(const std::vector<DoctorLine>& lines, Report& report) {
  std::int64_t n_wrong = 0;
  std::int64_t n_warnings = 0;
  for (const DoctorLine& line : lines) {
    n_wrong += line.finding == Finding::wrong ? 1 : 0;
    n_warnings += line.finding == Finding::warning ? 1 : 0;
    report.add_detail(line.subject,
                      fmt::format("{}: {}{}{}", to_string(line.finding), line.found,
                                  line.hint.is_empty() ? "" : "; hint: ", line.hint.text()));
  }
  report.add_achieved("wrong", n_wrong);
  report.add_achieved("warnings", n_warnings);
}

}  // namespace haarlight::capture
