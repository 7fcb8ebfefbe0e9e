// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"

/// @file
/// The command line of every program: arguments, options, flags, verbs, --help, --version and
/// --completions SHELL, which --help does not tell.
/// Only the .cpp sees CLI11, which costs seconds in every file that includes it.
///
///     CommandLine line("haarlight-sim", "a virtual rig", program_version());
///     line.root().option("RIG", &rig, "Rig file", {.type = "RIG.toml", .is_required = true});
///     if (const std::optional<ExitCode> end = line.parse(argc, argv)) {
///       return static_cast<int>(*end);
///     }

namespace CLI {  // NOLINT(readability-identifier-naming): CLI11's name
class App;
}

namespace haarlight::apps {

/// An enum's variable, by the words of its table (core/enum_words.h).
struct WordTarget {
  std::vector<std::string> words;  ///< of all its values
  std::string word;                ///< of its present value; empty: it has none
  std::function<void(const std::string& word)> set;
};

/// The variable that an option fills; it must live until the line is parsed. Real numbers are
/// finite. A list takes one value each time its option is given, a positional list all that
/// follow, unless OptionRules says otherwise.
using OptionTarget =
    std::variant<std::string*, int*, std::uint64_t*, double*, std::optional<int>*,
                 std::optional<double>*, std::vector<std::string>*, std::vector<int>*,
                 std::vector<double>*, WordTarget>;

/// Allowed values of a number, inclusive.
struct Bounds {
  double min = 0.0;
  double max = std::numeric_limits<double>::infinity();
};

/// What else is known of an option. A value that breaks a rule ends the program with usage.
struct OptionRules {
  std::string type = {};          ///< the value's name in --help; empty: by its C++ type
  std::string default_text = {};  ///< in --help; `shows_default` asks the variable instead
  std::vector<std::string> choices = {};  ///< an enum's: empty: all its words
  /// Of an optional enum: what is written for nothing, before the other choices; empty: nothing
  /// is what the variable holds without the option.
  std::string none = {};
  std::optional<Bounds> bounds = {};
  std::string excludes = {};     ///< an option defined before that may not stand beside it
  std::string environment = {};  ///< variable that gives the value when the option does not
  char delimiter = '\0';         ///< between the values of a list, in one word
  int count = 0;                 ///< values of a list; 0: any number
  bool is_required = false;
  bool shows_default = false;
  bool is_bytes = false;  ///< takes 512M and 4G, powers of 1024; for std::uint64_t
};

/// The words of all of an enum's values, or of some, for OptionRules::choices.
template <EnumWithWords Enum>
[[nodiscard]] std::vector<std::string> choices_of() {
  const std::span<const std::string_view> words = words_of(Enum{});
  return {words.begin(), words.end()};
}
template <EnumWithWords Enum>
[[nodiscard]] std::vector<std::string> choices_of(std::initializer_list<Enum> values) {
  std::vector<std::string> words;
  for (const Enum value : values) {
    words.emplace_back(to_string(value));
  }
  return words;
}

struct OptionTable;

/// One command: a program, or a verb of it. A handle; copies mean the same command.
class Command {
 public:
  /// A name without dashes is positional; "-o,--output" gives a short and a long name.
  void option(const std::string& names, OptionTarget target, const std::string& help,
              const OptionRules& rules = {});
  template <EnumWithWords Enum>
  void option(const std::string& names, Enum* target, const std::string& help,
              const OptionRules& rules = {}) {
    option(names,
           WordTarget{choices_of<Enum>(), std::string(to_string(*target)),
                      [target](const std::string& word) { *target = *value_of<Enum>(word); }},
           help, rules);
  }
  template <EnumWithWords Enum>
  void option(const std::string& names, std::optional<Enum>* target, const std::string& help,
              const OptionRules& rules = {}) {
    option(
        names,
        WordTarget{choices_of<Enum>(), *target ? std::string(to_string(**target)) : rules.none,
                   [target](const std::string& word) { *target = value_of<Enum>(word); }},
        help, rules);
  }
  void flag(const std::string& names, bool* target, const std::string& help);
  /// What --help says last: notes and examples.
  void footer(const std::string& text);
  /// A verb of this command.
  Command add_verb(const std::string& name, const std::string& help);
  /// A verb that this build lacks: --help does not list it, naming it is an error that says
  /// which option of the build, "HAARLIGHT_DAEMON", left it out.
  void leave_out(const std::string& verb, const std::string& option);
  /// Exactly one verb of this command must be named.
  void require_verb();
  /// Called during parse() when the line names this command, every value set.
  void on_chosen(std::function<void()> callback);
  /// With the verbs that lead to it, without the program: "rig doctor".
  [[nodiscard]] std::string name() const;

 private:
  friend class CommandLine;
  Command(CLI::App* app, OptionTable* table) : app_(app), table_(table) {}
  CLI::App* app_;
  OptionTable* table_;
};

/// The command line of a program. Not movable: verbs refer to it.
class CommandLine {
 public:
  /// `--version` prints program and version: "haarlight 0.1.0 (592dfa4)".
  CommandLine(const std::string& program, const std::string& description,
              const std::string& version);
  ~CommandLine();
  CommandLine(const CommandLine&) = delete;
  CommandLine& operator=(const CommandLine&) = delete;

  [[nodiscard]] Command root();
  /// Fills the variables, then calls what on_chosen() set. Help and version go to the standard
  /// output, problems to the standard error.
  /// @return  how the program must end at once: done after help, usage after a problem;
  ///          nothing when it has work to do
  [[nodiscard]] std::optional<ExitCode> parse(int argc, const char* const* argv);

 private:
  std::unique_ptr<CLI::App> app_;
  std::unique_ptr<OptionTable> table_;
};

}  // namespace haarlight::apps
