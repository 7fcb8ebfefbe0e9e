// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>

/// @file
/// What becomes of a program whose mapped file is cut short by another one, or whose disk fails, while it
/// reads it: the kernel sends SIGBUS, of which nothing can be thrown.

namespace haarlight {

/// From now on such a program ends with ExitCode::io, and a message that names the file and what to do;
/// other bus errors end it as before. Nothing is cleaned up: files are whole or absent as after a kill.
/// For short programs, in main().
/// @param program  for the message, a literal
void end_where_mapped_files_fail(const char* program);

/// Notes a mapping by its bytes, until it is forgotten. Of the 256 that are noted at once; others count as
/// unknown. For MappedFile.
void note_mapping(std::span<const std::byte> bytes, const std::filesystem::path& path) noexcept;
void forget_mapping(const std::byte* begin) noexcept;

}  // namespace haarlight
