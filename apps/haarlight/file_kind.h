// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <filesystem>
#include <span>
#include <string_view>

/// @file
/// Tells what a file is from what stands in it, so that `haarlight check` takes any of them.

#include "haarlight/core/enum_words.h"

namespace haarlight::apps {

enum class FileKind {
  rig,
  measured,
  profile,
  plan,
  shot_list,
  scene,
  volume,
  faults,
  cameras,
  environment,
  basis,
  stack
};
inline constexpr auto kFileKindWords = std::to_array<std::string_view>(
    {"rig", "measured", "profile", "plan", "shot-list", "scene", "volume", "faults", "cameras",
     "environment", "basis", "stack"});
constexpr std::span<const std::string_view> words_of(FileKind) { return kFileKindWords; }

/// @throws Error(usage)  not one of to_string()'s words
[[nodiscard]] FileKind file_kind_from_word(std::string_view word);

/// Pictures and folders are environments. A TOML file is what most of its top-level keys belong
/// to, so that one misspelt key does not hide the others.
/// @throws Error  missing, not TOML (with file:line:column), or keys of none of the kinds
[[nodiscard]] FileKind recognise_file(const std::filesystem::path& path);

}  // namespace haarlight::apps
