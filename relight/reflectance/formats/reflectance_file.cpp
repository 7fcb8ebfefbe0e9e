// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/reflectance_file.h"

#include <array>
#include <cmath>
#include <string>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/ptm_file.h"
#include "haarlight/relight/reflectance/formats/rti_file.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kHead = 16;  // bytes that distinguish the formats

struct FormatEntry {
  ReflectanceFormat format;
  std::string_view ending;  ///< empty: a folder
  ScaleRule rule;
  bool (*is_head)(std::string_view head);
  bool (*can_hold)(const ReflectanceModel& model);
  ReflectanceModel (*read)(const fs::path& path, const ReflectanceReading& reading);
  void (*write)(const fs::path& path, const ReflectanceModel& model,
                const ReflectanceWriting& writing);
};

bool is_ptm_model(const ReflectanceModel& model) {
  return model.basis == ReflectanceBasis::ptm && model.colour != ReflectanceColour::pca;
}
bool is_rti_model(const ReflectanceModel& model) {
  return model.basis == ReflectanceBasis::hsh && model.colour == ReflectanceColour::rgb;
}
bool is_web_model(const ReflectanceModel& model) {
  return model.basis == ReflectanceBasis::ptm || model.basis == ReflectanceBasis::bilinear ||
         (model.basis == ReflectanceBasis::hsh &&
          (model.n_terms == 9 ||
           (model.n_terms == 4 && model.colour == ReflectanceColour::rgb)));
}

constexpr std::array<FormatEntry, 3> kFormats{{
    {ReflectanceFormat::ptm, ".ptm", ScaleRule::ptm,
     [](std::string_view head) { return is_ptm(head); }, is_ptm_model,
     [](const fs::path& path, const ReflectanceReading& r) {
       return read_ptm(path, r.most_bytes);
     },
     [](const fs::path& path, const ReflectanceModel& model, const ReflectanceWriting& w) {
       write_ptm(path, model,
                 {.is_jpeg = w.is_jpeg,
                  .quality = static_cast<int>(std::lround(w.quality.value_or(95.0)))});
     }},
    {ReflectanceFormat::rti, ".rti", ScaleRule::rti,
     [](std::string_view head) { return is_rti(head); }, is_rti_model,
     [](const fs::path& path, const ReflectanceReading& r) {
       return read_rti(path, r.order4, r.most_bytes);
     },
     [](const fs::path& path, const ReflectanceModel& model, const ReflectanceWriting&) {
       write_rti(path, model);
     }},
    {ReflectanceFormat::web, "", ScaleRule::any, [](std::string_view) { return false; },
     is_web_model,
     [](const fs::path& path, const ReflectanceReading& r) {
       return read_web_folder(path, r.most_bytes);
     },
     [](const fs::path& path, const ReflectanceModel& model, const ReflectanceWriting& w) {
       write_web_folder(path, model, {.quality = w.quality.value_or(kWebQuality)});
     }},
}};

const FormatEntry& entry_of(ReflectanceFormat format) noexcept {
  return kFormats[static_cast<std::size_t>(format)];
}

}  // namespace

std::optional<ReflectanceFormat> recognise_reflectance(const fs::path& path) {
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) {
    return is_web_folder(path) ? std::optional(ReflectanceFormat::web) : std::nullopt;
  }
  const std::string head = read_head(path, kHead);
  for (const FormatEntry& entry : kFormats) {
    if (entry.is_head(head)) {
      return entry.format;
    }
  }
  return std::nullopt;
}

ReflectanceFormat reflectance_format_of_name(const fs::path& path) {
  std::string ending = path.extension().string();
  for (char& c : ending) {
    c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  for (const FormatEntry& entry : kFormats) {
    if (ending == entry.ending) {
      return entry.format;
    }
  }
  throw Error(fmt::format("\"{}\" is not the ending of a picture that can be relit", ending),
              path.string(),
              "end the name in .ptm or .rti; a name without an ending is a folder",
              ExitCode::usage);
}

ReflectanceModel read_reflectance(const fs::path& path, const ReflectanceReading& reading) {
  const std::optional<ReflectanceFormat> format = recognise_reflectance(path);
  if (!format) {
    throw Error("not a picture that can be relit", path.string(),
                "give a .ptm, a .rti of harmonics, or a folder with Relight's info.json");
  }
  ReflectanceModel model = entry_of(*format).read(path, reading);
  model.transfer = reading.transfer;
  return model;
}

bool can_hold(ReflectanceFormat format, const ReflectanceModel& model) noexcept {
  return model.transfer == Transfer::srgb && entry_of(format).can_hold(model);
}

ScaleRule scale_rule(ReflectanceFormat format) noexcept { return entry_of(format).rule; }

void write_reflectance(const fs::path& path, const ReflectanceModel& model,
                       const ReflectanceWriting& writing) {
  const FormatEntry& entry = entry_of(reflectance_format_of_name(path));
  if (obeys(entry.rule, model)) {
    entry.write(path, model, writing);
  } else {
    entry.write(path, with_scales_of(entry.rule, model), writing);
  }
}

}  // namespace haarlight::relight
