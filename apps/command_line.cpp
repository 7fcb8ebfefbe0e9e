// SPDX-License-Identifier: Apache-2.0
#include "apps/command_line.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <map>
#include <sstream>
#include <type_traits>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "apps/completions.h"
#include "core/config_table.h"

namespace haarlight::apps {

/// What CLI11 does not tell of its options and verbs.
struct OptionTable {
  std::map<const CLI::Option*, OptionRules> rules;
  std::map<const CLI::App*, std::string> left_out;  ///< by which option of the build
};

namespace {

template <class Target>
constexpr bool kIsList =
    std::is_same_v<Target, std::vector<std::string>> ||
    std::is_same_v<Target, std::vector<int>> || std::is_same_v<Target, std::vector<double>>;

template <class Target>
constexpr bool kIsReal =
    std::is_same_v<Target, double> || std::is_same_v<Target, std::optional<double>> ||
    std::is_same_v<Target, std::vector<double>>;

std::string describe(const Bounds& bounds) {
  return std::isinf(bounds.max) ? fmt::format("of at least {}", bounds.min)
                                : fmt::format("from {} to {}", bounds.min, bounds.max);
}

constexpr std::size_t kHelpWidth = 80;   // columns of a terminal
constexpr std::size_t kHelpIndent = 26;  // where descriptions begin

/// `name` and, from kHelpIndent on, its description in lines of at most kHelpWidth.
std::string help_entry(const std::string& name, const std::string& description) {
  std::string out = "  " + name;
  std::size_t column = out.size();
  if (column + 2 > kHelpIndent) {
    out += "\n";
    column = 0;
  }
  std::istringstream lines(description);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    bool is_first = true;
    for (std::string word; words >> word;) {
      if (is_first ? column > kHelpIndent : column + 1 + word.size() > kHelpWidth) {
        out += "\n";
        column = 0;
        is_first = true;
      }
      const std::size_t gap = is_first ? kHelpIndent - column : 1;
      out += std::string(gap, ' ') + word;
      column += gap + word.size();
      is_first = false;
    }
    column = kHelpWidth;  // the next one begins below
  }
  return out + "\n";
}

/// Prose in lines of at most kHelpWidth; examples, which begin with blanks, and headings as
/// they are.
std::string help_footer(const std::string& text) {
  std::string out;
  std::size_t column = 0;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const bool is_kept =
        line.empty() || line.front() == ' ' || line == "Example:" || line == "Examples:";
    if (is_kept && column > 0) {
      out += "\n";
      column = 0;
    }
    if (is_kept) {
      out += line + "\n";
      continue;
    }
    std::istringstream words(line);
    for (std::string word; words >> word;) {
      if (column > 0) {
        const bool fits = column + 1 + word.size() <= kHelpWidth;
        out += fits ? " " : "\n";
        column = fits ? column + 1 : 0;
      }
      out += word;
      column += word.size();
    }
  }
  while (!out.empty() && out.back() == '\n') {
    out.pop_back();
  }
  return out;
}

/// CLI11's help at the width of a terminal. What it would say of types, ranges and defaults
/// stands in the descriptions (Command::option).
class HelpFormat : public CLI::Formatter {
 public:
  [[nodiscard]] std::string make_option(const CLI::Option* option,
                                        bool is_positional) const override {
    return help_entry(make_option_name(option, is_positional) + make_option_opts(option),
                      make_option_desc(option));
  }
  [[nodiscard]] std::string make_subcommand(const CLI::App* verb) const override {
    return help_entry(verb->get_name(), verb->get_description());
  }
};

/// CLI11's own range lets NaN through, and a real number without bounds may be infinite there.
CLI::Validator number_check(const std::optional<Bounds>& bounds) {
  const auto check = [bounds](const std::string& text) -> std::string {
    double value = 0.0;
    const bool is_good = CLI::detail::lexical_cast(text, value) && std::isfinite(value);
    if (is_good && (!bounds || (value >= bounds->min && value <= bounds->max))) {
      return {};
    }
    return fmt::format("{} is not a number{}{}", text, bounds ? " " : "",
                       bounds ? describe(*bounds) : std::string());
  };
  return {check, ""};
}

/// A value's name in --help.
template <class Target>
std::string type_of(const OptionRules& rules) {
  if (!rules.type.empty()) {
    return rules.type;
  }
  if (!rules.choices.empty()) {
    return "WORD";
  }
  if (rules.is_bytes) {
    return "BYTES";
  }
  if constexpr (std::is_same_v<Target, std::string> ||
                std::is_same_v<Target, std::vector<std::string>>) {
    return "TEXT";
  }
  return kIsReal<Target> ? "X" : "N";
}

/// What --help says after an option's description: " (required; 0 to 1; default: 0.5)".
std::string describe(const OptionRules& rules, bool is_positional, const std::string& value) {
  std::vector<std::string> clauses;
  if (rules.is_required && !is_positional) {
    clauses.emplace_back("required");
  }
  if (!rules.choices.empty() && rules.type.empty()) {
    clauses.push_back(fmt::format("{}", fmt::join(rules.choices, ", ")));
  }
  if (rules.bounds) {
    clauses.push_back(std::isinf(rules.bounds->max)
                          ? fmt::format("at least {}", rules.bounds->min)
                          : fmt::format("{} to {}", rules.bounds->min, rules.bounds->max));
  }
  if (!value.empty()) {
    clauses.push_back("default: " + value);
  }
  if (!rules.excludes.empty()) {
    clauses.push_back("not with " + rules.excludes);
  }
  if (!rules.environment.empty()) {
    clauses.push_back("or $" + rules.environment);
  }
  return clauses.empty() ? std::string() : fmt::format(" ({})", fmt::join(clauses, "; "));
}

/// What an option whose target holds a Value lets pass, and what --help says of it.
template <class Value>
CLI::Option* with_rules(CLI::Option* option, const std::string& names, const std::string& help,
                        const OptionRules& rules) {
  if (rules.bounds || kIsReal<Value>) {
    option->check(number_check(rules.bounds));
  }
  if (kIsList<Value> && rules.count == 0 && !option->get_positional()) {
    option->allow_extra_args(false);  // else `--light 3 BASIS` would take BASIS as a light
  }
  if (rules.shows_default) {
    option->capture_default_str();
  }
  const bool is_positional = option->get_positional();
  const std::string type = type_of<Value>(rules);
  option->option_text(is_positional && type == names ? " " : type);
  option->description(help + describe(rules, is_positional,
                                      rules.default_text.empty() ? option->get_default_str()
                                                                 : rules.default_text));
  return option;
}

template <class Value>
CLI::Option* add_option(CLI::App& app, const std::string& names, Value* target,
                        const std::string& help, const OptionRules& rules) {
  return with_rules<Value>(app.add_option(names, *target), names, help, rules);
}

CLI::Option* add_option(CLI::App& app, const std::string& names, const WordTarget& target,
                        const std::string& help, const OptionRules& rules) {
  OptionRules shown = rules;
  if (rules.shows_default) {
    shown.default_text = target.word;
  }
  return with_rules<std::string>(app.add_option_function(names, target.set), names, help,
                                 shown);
}

/// An enum's words are its choices.
OptionRules with_choices(OptionRules rules, const OptionTarget& target) {
  if (const auto* words = std::get_if<WordTarget>(&target)) {
    if (rules.choices.empty()) {
      rules.choices = words->words;
    }
    if (!rules.none.empty()) {
      rules.choices.insert(rules.choices.begin(), rules.none);
    }
  }
  return rules;
}

/// CLI11 only says that a verb is missing; this names the wrong one, "haarlight rig docter".
/// Empty: it is not that.
std::string unknown_verb(const CLI::App& program, int argc, const char* const* argv) {
  const CLI::App* app = &program;
  std::string words = app->get_name();
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    std::vector<std::string> verbs;
    const CLI::App* next = nullptr;
    for (const CLI::App* verb : app->get_subcommands([](const CLI::App*) { return true; })) {
      verbs.push_back(verb->get_name());
      next = verb->get_name() == word ? verb : next;
    }
    if (verbs.empty() || word.empty() || word.front() == '-') {
      return {};
    }
    if (next == nullptr) {
      const std::string near = nearest_word(word, verbs);
      return fmt::format("{} is not a verb of {}{}\n", word, words,
                         near.empty() ? "" : fmt::format(": did you mean {}?", near));
    }
    app = next;
    words += " " + word;
  }
  return {};
}

/// The verb that the line names, "haarlight rig doctor"; its words, and itself.
std::pair<std::string, const CLI::App*> chosen_verb(const CLI::App& app) {
  std::string words = app.get_name();
  const CLI::App* verb = &app;
  for (auto chosen = app.get_subcommands(); !chosen.empty(); chosen = verb->get_subcommands()) {
    verb = chosen.front();
    words += " " + verb->get_name();
  }
  return {words, verb};
}

/// The first word that the verb does not know, and the option that was perhaps meant.
std::string unknown_word(const CLI::App& app, const CLI::App& verb) {
  std::vector<std::string> options;
  for (const CLI::Option* option : verb.get_options()) {
    for (const std::string& name : option->get_lnames()) {
      options.push_back("--" + name);
    }
  }
  const std::vector<std::string> unknown = app.remaining(true);
  const auto word = std::find_if(unknown.begin(), unknown.end(),
                                 [](const std::string& w) { return w.front() == '-'; });
  if (word == unknown.end()) {
    return unknown.empty() ? std::string() : fmt::format("what is {}?", unknown.front());
  }
  const std::string near = nearest_word(*word, options);
  return fmt::format("there is no option {}{}", *word,
                     near.empty() ? "" : fmt::format(": did you mean {}?", near));
}

/// What is wrong with the line, of which command, and where its options are told.
std::string usage_words(const CLI::App& app, const CLI::ParseError& error) {
  const auto chosen = chosen_verb(app);
  const bool is_unknown =
      error.get_exit_code() == static_cast<int>(CLI::ExitCodes::ExtrasError);
  std::string problem = is_unknown ? unknown_word(app, *chosen.second) : std::string();
  if (problem.empty()) {
    problem = error.what();
    const std::size_t colon =
        problem.find(": 1 required ");  // "--lights: 1 required FILE missing"
    if (colon != std::string::npos && problem.ends_with(" missing")) {
      problem = problem.substr(0, colon) + " is without its value";
    }
  }
  return fmt::format("{0}: {1}\n  hint: {0} --help tells what it takes\n", chosen.first,
                     problem);
}

/// Empty: the build has the verb that the line names.
std::string left_out_words(const CLI::App& app, const OptionTable& table) {
  const auto [words, verb] = chosen_verb(app);
  const auto found = table.left_out.find(verb);
  return found == table.left_out.end()
             ? std::string()
             : fmt::format("{}: this build was made without it\n  hint: build with -D{}=ON\n",
                           words, found->second);
}

CompletedOption completed(const CLI::Option& option, const OptionTable& table) {
  CompletedOption out;
  out.help = option.get_description();
  std::replace(out.help.begin(), out.help.end(), '\n', ' ');
  for (const std::string& name : option.get_lnames()) {
    out.names.push_back("--" + name);
  }
  for (const std::string& name : option.get_snames()) {
    out.names.push_back("-" + name);
  }
  if (const auto rules = table.rules.find(&option); rules != table.rules.end()) {
    const bool is_named = option.get_positional() && rules->second.type.empty();
    out.value = is_named ? option.get_name(true) : option.get_option_text();
    const ValueKind kind = value_kind(out.value);
    out.words = rules->second.choices.empty() ? kind.words : rules->second.choices;
    out.is_file = kind.is_file;
  }
  return out;
}

/// What of the command --help shows.
CompletedCommand completed(const CLI::App& app, const OptionTable& table) {
  CompletedCommand out{
      .name = app.get_name(), .help = app.get_description(), .options = {}, .verbs = {}};
  for (const CLI::Option* option : app.get_options()) {
    if (!option->get_group().empty()) {
      out.options.push_back(completed(*option, table));
    }
  }
  for (const CLI::App* verb : app.get_subcommands([](const CLI::App*) { return true; })) {
    if (!verb->get_group().empty()) {
      out.verbs.push_back(completed(*verb, table));
    }
  }
  return out;
}

}  // namespace

void Command::option(const std::string& names, OptionTarget target, const std::string& help,
                     const OptionRules& given) {
  const OptionRules rules = with_choices(given, target);
  CLI::Option* option = std::visit(
      [&](const auto& held) { return add_option(*app_, names, held, help, rules); }, target);
  table_->rules.emplace(option, rules);
  option->required(rules.is_required);
  if (!rules.choices.empty()) {
    option->check(CLI::IsMember(rules.choices));
  }
  if (rules.is_bytes) {
    option->transform(CLI::AsSizeValue(false));
  }
  if (!rules.excludes.empty()) {
    option->excludes(app_->get_option(rules.excludes));
  }
  if (!rules.environment.empty()) {
    option->envname(rules.environment);
  }
  if (rules.delimiter != '\0') {
    option->delimiter(rules.delimiter);
  }
  if (rules.count > 0) {
    option->expected(rules.count);
  }
}

void Command::flag(const std::string& names, bool* target, const std::string& help) {
  app_->add_flag(names, *target, help);
}

void Command::footer(const std::string& text) { app_->footer(help_footer(text)); }

Command Command::add_verb(const std::string& name, const std::string& help) {
  return {app_->add_subcommand(name, help), table_};
}

void Command::leave_out(const std::string& verb, const std::string& option) {
  CLI::App* app = app_->add_subcommand(verb);
  app->group("");
  app->prefix_command();  // whatever follows
  app->set_help_flag();
  table_->left_out.emplace(app, option);
}

void Command::require_verb() { app_->require_subcommand(1); }

void Command::on_chosen(std::function<void()> callback) { app_->callback(std::move(callback)); }

std::string Command::name() const {
  const CLI::App* above = app_->get_parent();
  if (above == nullptr) {
    return {};
  }
  const std::string words = Command(app_->get_parent(), table_).name();
  return words.empty() ? app_->get_name() : words + " " + app_->get_name();
}

CommandLine::CommandLine(const std::string& program, const std::string& description,
                         const std::string& version)
    : app_(std::make_unique<CLI::App>(description, program)),
      table_(std::make_unique<OptionTable>()) {
  app_->formatter(std::make_shared<HelpFormat>());
  app_->set_version_flag("--version", program + " " + version);
  app_->add_option_function<std::string>(
          "--completions",
          [this](const std::string& shell) {
            throw CLI::CallForVersion(
                completions(completed(*app_, *table_), *value_of<Shell>(shell)), 0);
          })
      ->check(CLI::IsMember(choices_of<Shell>()))
      ->group("");
}

CommandLine::~CommandLine() = default;

Command CommandLine::root() { return {app_.get(), table_.get()}; }

std::optional<ExitCode> CommandLine::parse(int argc, const char* const* argv) {
  try {
    app_->parse(argc, argv);
    if (const std::string lacks = left_out_words(*app_, *table_); !lacks.empty()) {
      std::cerr << lacks;
      return ExitCode::usage;
    }
    return std::nullopt;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) {
      app_->exit(error, std::cout, std::cerr);
      return ExitCode::done;
    }
    if (const std::string wrong = unknown_verb(*app_, argc, argv); !wrong.empty()) {
      std::cerr << wrong << "Run with --help for more information.\n";
    } else {
      std::cerr << usage_words(*app_, error);
    }
    return ExitCode::usage;
  }
}

}  // namespace haarlight::apps
