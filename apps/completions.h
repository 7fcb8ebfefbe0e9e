// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"

/// @file
/// What a shell completes after a program's name, as text for the shell: `haarlight
/// --completions bash`. The words are those of --help (apps/command_line.cpp gathers both at
/// once).

namespace haarlight::apps {

/// An option, a flag or a positional argument.
struct CompletedOption {
  std::vector<std::string> names;  ///< with their dashes; empty: positional
  std::string help;                ///< one line
  std::string value;               ///< its name in --help; empty: a flag
  std::vector<std::string> words;  ///< values that are known
  bool is_file = false;            ///< a file or folder may be given
};

/// A program, or a verb of it.
struct CompletedCommand {
  std::string name;
  std::string help;
  std::vector<CompletedOption> options;
  std::vector<CompletedCommand> verbs;
};

enum class Shell {
  bash,  ///< 4.4 or later, without the package bash-completion
  zsh,
  fish,
};
inline constexpr auto kShellWords = std::to_array<std::string_view>({"bash", "zsh", "fish"});
constexpr std::span<const std::string_view> words_of(Shell) { return kShellWords; }

/// A script that the shell reads.
[[nodiscard]] std::string completions(const CompletedCommand& program, Shell shell);

/// What kind of value an option takes, from its name in --help, "FILE|SESSION|none": is one of
/// the alternatives a file, and which ones are words to be typed as they are?
struct ValueKind {
  bool is_file = false;
  std::vector<std::string> words;
};
[[nodiscard]] ValueKind value_kind(const std::string& name);

}  // namespace haarlight::apps
