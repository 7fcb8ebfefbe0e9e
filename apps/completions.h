// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

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

/// A script that the shell reads.
/// @param shell  "bash" (4.4 or later, without the package bash-completion), "zsh", "fish"
/// @throws Error  another shell
[[nodiscard]] std::string completions(const CompletedCommand& program,
                                      const std::string& shell);

/// What kind of value an option takes, from its name in --help, "FILE|SESSION|none": is one of
/// the alternatives a file, and which ones are words to be typed as they are?
struct ValueKind {
  bool is_file = false;
  std::vector<std::string> words;
};
[[nodiscard]] ValueKind value_kind(const std::string& name);

}  // namespace haarlight::apps
