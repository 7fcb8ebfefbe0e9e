// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "relight/hull/shadow_hull.h"

/// @file
/// A shadow hull kept between commands, little-endian: "HLHULL\0" and a version byte, 32 bytes of
/// key, the grid, the summary, runs of equal states, two bytes of evidence per voxel that is not
/// empty, the captures' planes with runs of equal pixels, a hash of everything before it. Not for exchange: other programs read the .ply and .vtu that `haarlight hull` writes.

namespace haarlight::relight {

inline constexpr std::uint8_t kHullVersion = 8;

/// @param key  of what the hull was made from, 32 characters
/// @throws Error  the file cannot be written, or exists and is not a hull; the old one stays
void write_hull(const ShadowHull& hull, const std::string& key,
                const std::filesystem::path& file);

/// The hull of this key; nothing if the file is missing, damaged, of another version or of
/// another key: it is carved again then.
[[nodiscard]] std::optional<ShadowHull> read_hull_of(const std::filesystem::path& file,
                                                     const std::string& key);

/// The hull of a file that a user names, whatever it was made from.
/// @throws Error  no such file, not a hull, damaged, of another version
[[nodiscard]] ShadowHull read_hull(const std::filesystem::path& file);

}  // namespace haarlight::relight
