// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file `.ptm`, the file format of polynomial texture maps. Read: PTM_1.0 to 1.2, RGB, LRGB
/// and both as JPEG; written: PTM_1.2. Byte by byte: docs/reference/reflectance-formats.md.

namespace haarlight::relight {

/// True for the first bytes of any `.ptm`.
[[nodiscard]] bool is_ptm(std::string_view head) noexcept;

/// Rows come out top first, planes in the order of ReflectanceModel. The file does not state
/// the transfer of its colours: srgb is assumed.
/// @param where  the file's name, for messages
/// @param most_bytes  of planes
/// @throws Error  with the offset: not a .ptm, a form that is not read (LUM, LUT, JPEGLS,
///                planes stored as differences), too few or too many bytes, numbers out of
///                range
[[nodiscard]] ReflectanceModel parse_ptm(std::string_view bytes, const std::string& where,
                                         std::uint64_t most_bytes = kMostPlaneBytes);
[[nodiscard]] ReflectanceModel read_ptm(const std::filesystem::path& path,
                                        std::uint64_t most_bytes = kMostPlaneBytes);

struct PtmOptions {
  bool is_jpeg = false;
  int quality = 95;  ///< of the JPEG forms, 1 to 100
};

/// Writes a model whose scales obey ScaleRule::ptm (quantise.h: with_scales_of). A file read by
/// read_ptm is reproduced byte for byte if its program wrote numbers like HP's PTMfitter.
/// @throws Error  not ptm in rgb or lrgb, or not srgb; unwritable
void write_ptm(const std::filesystem::path& path, const ReflectanceModel& model,
               const PtmOptions& options = {});

}  // namespace haarlight::relight
