#include "apps/command_line.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <type_traits>
#include <utility>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "core/config_table.h"

namespace haarlight {

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

/// What --help says of them, between the option's type and its default.
std::string name_of(const Bounds& bounds, bool is_real) {
  if (bounds.min == 0.0 && std::isinf(bounds.max)) {
    return "NONNEGATIVE";
  }
  return fmt::format("{} in [{} - {}]", is_real ? "FLOAT" : "INT", bounds.min, bounds.max);
}

/// CLI11's own range lets NaN through, and a real number without bounds may be infinite there.
CLI::Validator number_check(const std::optional<Bounds>& bounds, bool is_real) {
  const auto check = [bounds](const std::string& text) -> std::string {
    double value = 0.0;
    const bool is_good = CLI::detail::lexical_cast(text, value) && std::isfinite(value);
    if (is_good && (!bounds || (value >= bounds->min && value <= bounds->max))) {
      return {};
    }
    return fmt::format("{} is not a number{}{}", text, bounds ? " " : "",
                       bounds ? describe(*bounds) : std::string());
  };
  return {check, bounds ? name_of(*bounds, is_real) : std::string()};
}

template <class Target>
CLI::Option* add_option(CLI::App& app, const std::string& names, Target& target,
                        const std::string& help, const OptionRules& rules) {
  CLI::Option* option = app.add_option(names, target, help);
  if (rules.bounds || kIsReal<Target>) {
    option->check(number_check(rules.bounds, kIsReal<Target>));
  }
  if (kIsList<Target> && rules.count == 0 && !option->get_positional()) {
    option->allow_extra_args(false);  // else `--light 3 BASIS` would take BASIS as a light
  }
  if (rules.shows_default) {
    option->capture_default_str();
  }
  return option;
}

/// CLI11 only says that a verb is missing; this names the wrong one. Empty: it is not that.
std::string unknown_verb(const CLI::App& app, int argc, const char* const* argv) {
  std::vector<std::string> verbs;
  for (const CLI::App* verb : app.get_subcommands([](const CLI::App*) { return true; })) {
    verbs.push_back(verb->get_name());
  }
  const std::string word = argc > 1 ? argv[1] : "";
  if (verbs.empty() || word.empty() || word.front() == '-' ||
      std::find(verbs.begin(), verbs.end(), word) != verbs.end()) {
    return {};
  }
  const std::string near = nearest_word(word, verbs);
  return fmt::format("{} is not a verb of {}{}\n", word, app.get_name(),
                     near.empty() ? "" : fmt::format(": did you mean {}?", near));
}

}  // namespace

void Command::option(const std::string& names, OptionTarget target, const std::string& help,
                     const OptionRules& rules) {
  CLI::Option* option = std::visit(
      [&](auto* held) { return add_option(*app_, names, *held, help, rules); }, target);
  option->required(rules.is_required);
  if (!rules.type.empty()) {
    option->type_name(rules.type);
  }
  if (!rules.choices.empty()) {
    option->check(CLI::IsMember(rules.choices));
  }
  if (rules.is_bytes) {
    option->transform(CLI::AsSizeValue(false));
  }
  if (!rules.default_text.empty()) {
    option->default_str(rules.default_text);
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

void Command::footer(const std::string& text) { app_->footer(text); }

Command Command::add_verb(const std::string& name, const std::string& help) {
  return Command(app_->add_subcommand(name, help));
}

void Command::on_chosen(std::function<void()> callback) { app_->callback(std::move(callback)); }

std::string Command::name() const { return app_->get_name(); }

CommandLine::CommandLine(const std::string& program, const std::string& description,
                         const std::string& version)
    : app_(std::make_unique<CLI::App>(description, program)) {
  app_->set_version_flag("--version", version);
}

CommandLine::~CommandLine() = default;

Command CommandLine::root() { return Command(app_.get()); }

void CommandLine::require_verb() { app_->require_subcommand(1); }

std::optional<ExitCode> CommandLine::parse(int argc, const char* const* argv) {
  try {
    app_->parse(argc, argv);
    return std::nullopt;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) {
      app_->exit(error, std::cout, std::cerr);
      return ExitCode::done;
    }
    if (const std::string wrong = unknown_verb(*app_, argc, argv); !wrong.empty()) {
      std::cerr << wrong << "Run with --help for more information.\n";
    } else {
      app_->exit(error, std::cout, std::cerr);
    }
    return ExitCode::usage;
  }
}

}  // namespace haarlight
