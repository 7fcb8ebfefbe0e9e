// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file `.rti` with hemispherical harmonics ("#HSH1.2"): 4, 9 or 16 terms of R, G and B, one
/// byte each. Byte by byte: docs/reference/reflectance-formats.md.

namespace haarlight::relight {

/// True for the first bytes of any `.rti`.
[[nodiscard]] bool is_rti(std::string_view head) noexcept;

/// Rows are top first, as in the file. LF and CRLF line ends, comment lines that start with #.
/// The file does not state the transfer of its colours: srgb is assumed.
/// @param most_bytes  of planes
/// @param order4  the basis convention of a file of 16 terms; the file does not state it
/// @throws Error  with the offset: not a .rti, of another type or element size, too few or too
///                many bytes, a scale that is not a finite number
[[nodiscard]] ReflectanceModel parse_rti(std::string_view bytes, const std::string& where,
                                         HshOrder4 order4 = HshOrder4::exact,
                                         std::uint64_t most_bytes = kMostPlaneBytes);
[[nodiscard]] ReflectanceModel read_rti(const std::filesystem::path& path,
                                        HshOrder4 order4 = HshOrder4::exact,
                                        std::uint64_t most_bytes = kMostPlaneBytes);

/// Writes a model whose scales obey ScaleRule::rti (quantise.h: with_scales_of), with LF. What
/// read_rti read is reproduced byte for byte except for comments and line ends.
/// @throws Error  not hsh in rgb, or not srgb; unwritable
void write_rti(const std::filesystem::path& path, const ReflectanceModel& model);

}  // namespace haarlight::relight
