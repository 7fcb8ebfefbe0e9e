// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/measured_file.h"

#include <chrono>

#include <fmt/chrono.h>
#include <fmt/format.h>

#include "core/report.h"
#include "haarlight/core/files.h"

namespace haarlight::relight {

namespace {

constexpr std::uintmax_t kMaxMeasured = 16U << 20U;

}  // namespace

MeasuredFile::MeasuredFile(const Rig& written)
    : written_(written), file_(measured_path(written.file)) {
  std::error_code ignored;
  if (std::filesystem::exists(file_, ignored)) {
    values = parse_measured(read_file(file_, kMaxMeasured), file_.string());
  }
  values.date = fmt::format(
      "{:%FT%TZ}",
      fmt::gmtime(std::chrono::system_clock::to_time_t(std::chrono::system_clock::now())));
  values.tool = fmt::format("haarlight {}", kVersion);
  values.rig_hash = written.hash;
}

std::size_t MeasuredFile::write() {
  const std::string text = to_toml(values);
  // Every program will read this file: verify that it parses before writing it.
  (void)parse_rig(join_rig_text({written_.text, text}, file_.string()), written_.file.string());
  write_file_atomically(file_, text);
  return text.size();
}

}  // namespace haarlight::relight
