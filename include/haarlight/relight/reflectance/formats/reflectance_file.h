// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <filesystem>
#include <optional>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// All file formats of a ReflectanceModel: recognised by content on reading, by name on
/// writing. To add a format: its pair of files here, and a line in the table of the .cpp.

namespace haarlight::relight {

enum class ReflectanceFormat {
  ptm,  ///< ".ptm"
  rti,  ///< ".rti"
  web,  ///< a name without an extension: Relight's folder
};
inline constexpr auto kReflectanceFormatWords =
    std::to_array<std::string_view>({".ptm", ".rti", "web folder"});
constexpr std::span<const std::string_view> words_of(ReflectanceFormat) {
  return kReflectanceFormatWords;
}

/// By content; nothing where the path is none of them.
/// @throws Error  missing, unreadable
[[nodiscard]] std::optional<ReflectanceFormat> recognise_reflectance(
    const std::filesystem::path& path);

/// By name. @throws Error(usage)  an unknown extension
[[nodiscard]] ReflectanceFormat reflectance_format_of_name(const std::filesystem::path& path);

/// What files do not state themselves.
struct ReflectanceReading {
  Transfer transfer = Transfer::srgb;
  HshOrder4 order4 = HshOrder4::exact;
  std::uint64_t most_bytes = kMostPlaneBytes;  ///< of planes; larger files are refused
};

/// @throws Error  none of the formats, or as that format's reader
[[nodiscard]] ReflectanceModel read_reflectance(const std::filesystem::path& path,
                                                const ReflectanceReading& reading = {});

/// Whether a format can hold the model unchanged except for its scales.
[[nodiscard]] bool can_hold(ReflectanceFormat format, const ReflectanceModel& model) noexcept;
[[nodiscard]] ScaleRule scale_rule(ReflectanceFormat format) noexcept;

struct ReflectanceWriting {
  bool is_jpeg = false;  ///< .ptm: the JPEG forms
  /// Of JPEG pictures, 1 to 100; nothing: 95 for a .ptm, which takes whole numbers, kWebQuality
  /// for a folder.
  std::optional<double> quality;
};

/// Rounds the scales to what the format can express (quantise.h), then writes.
/// @throws Error  not can_hold(); unwritable
void write_reflectance(const std::filesystem::path& path, const ReflectanceModel& model,
                       const ReflectanceWriting& writing = {});

}  // namespace haarlight::relight
