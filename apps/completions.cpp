// SPDX-License-Identifier: Apache-2.0
#include "apps/completions.h"

#include <algorithm>
#include <cctype>
#include <iterator>
#include <sstream>
#include <string_view>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::apps {

namespace {

// Names of values that are files or folders; those with an ending (RIG.toml) are files, too.
constexpr std::string_view kFiles[] = {"BASIS",  "DIR",     "ENV",     "FIFO",  "FILE",
                                       "FOLDER", "IN",      "MASK",    "NODE",  "OUT",
                                       "PATH",   "PICTURE", "SESSION", "SOCKET"};

/// act(command, path) for all commands of the tree; the path is the verbs that lead to one: "",
/// " rig", " rig doctor".
template <class Act>
void visit(const CompletedCommand& command, const std::string& path, const Act& act) {
  act(command, path);
  for (const CompletedCommand& verb : command.verbs) {
    visit(verb, path + " " + verb.name, act);
  }
}

/// As one word of a shell. In fish alone a backslash counts between the quotes.
std::string quoted(const std::string& text, bool is_fish = false) {
  std::string out = "'";
  for (const char c : text) {
    if (is_fish && (c == '\'' || c == '\\')) {
      out += '\\';
      out += c;
    } else {
      out += c == '\'' ? std::string(R"('\'')") : std::string(1, c);
    }
  }
  return out + "'";
}

/// A shell's function: "_haarlight_rig_doctor".
std::string function_name(const std::string& program, const std::string& path) {
  std::string name = "_" + program + path;
  std::replace_if(
      name.begin(), name.end(), [](unsigned char c) { return std::isalnum(c) == 0; }, '_');
  return name;
}

std::vector<std::string> verb_names(const CompletedCommand& command) {
  std::vector<std::string> names;
  std::transform(command.verbs.begin(), command.verbs.end(), std::back_inserter(names),
                 [](const CompletedCommand& verb) { return verb.name; });
  return names;
}

/// ' rig'|' rig doctor'|...
std::string verb_paths(const CompletedCommand& program, const char* separator) {
  std::vector<std::string> paths;
  visit(program, "", [&paths](const CompletedCommand&, const std::string& path) {
    if (!path.empty()) {
      paths.push_back(quoted(path));
    }
  });
  return fmt::format("{}", fmt::join(paths, separator));
}

// ---- bash ----

/// What is known of the word to come where `previous` is an option's name, and else.
std::string bash_case(const CompletedCommand& command, const std::string& path) {
  std::vector<std::string> names;
  std::vector<std::string> words = verb_names(command);
  bool is_file = false;
  std::string out = fmt::format("    {})\n      case $previous in\n", quoted(path));
  for (const CompletedOption& option : command.options) {
    names.insert(names.end(), option.names.begin(), option.names.end());
    if (option.names.empty()) {
      words.insert(words.end(), option.words.begin(), option.words.end());
      is_file = is_file || option.is_file;
    } else if (!option.value.empty()) {
      out += fmt::format("        {}) words={} files={} ;;\n", fmt::join(option.names, "|"),
                         quoted(fmt::format("{}", fmt::join(option.words, " "))),
                         option.is_file ? "yes" : "no");
    }
  }
  out += fmt::format("        *) options={} words={} files={} ;;\n      esac ;;\n",
                     quoted(fmt::format("{}", fmt::join(names, " "))),
                     quoted(fmt::format("{}", fmt::join(words, " "))), is_file ? "yes" : "no");
  return out;
}

std::string for_bash(const CompletedCommand& program) {
  std::string cases;
  visit(program, "", [&cases](const CompletedCommand& command, const std::string& path) {
    cases += bash_case(command, path);
  });
  const std::string name = function_name(program.name, "");
  std::string out = fmt::format(
      "# bash completion of {0}, by {0} --completions bash\n{1}() {{\n", program.name, name);
  out += R"(  local current=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD-1]}
  local at= i options= words= files=no
  if [[ $current == = ]]; then  # --option=value is three words
    current=
  elif [[ $previous == = ]]; then
    previous=${COMP_WORDS[COMP_CWORD-2]}
  fi
)";
  if (!program.verbs.empty()) {
    out += fmt::format(
        "  for ((i = 1; i < COMP_CWORD; ++i)); do\n    case \"$at ${{COMP_WORDS[i]}}\" in\n"
        "      {}) at+=\" ${{COMP_WORDS[i]}}\" ;;\n    esac\n  done\n",
        verb_paths(program, "|"));
  }
  out += "  case $at in\n" + cases + "  esac\n";
  out += R"(  [[ $current != -* ]] || words=$options
  mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
  if [[ $files == yes && ( $current != -* || -z $options ) ]]; then
    local -a found
    mapfile -t found < <(compgen -f -- "$current")
    COMPREPLY+=("${found[@]}")
    compopt -o filenames 2>/dev/null
  fi
}
)";
  return out + fmt::format("complete -F {} {}\n", name, program.name);
}

// ---- zsh ----

/// Text within the brackets and between the colons of a specification of _arguments.
std::string zsh_text(const std::string& text) {
  std::string out;
  for (const char c : text) {
    if (c == '[' || c == ']' || c == ':' || c == '\\') {
      out += '\\';
    }
    out += c;
  }
  return out;
}

std::string zsh_value(const CompletedOption& option) {
  std::string action = option.is_file ? "_files" : " ";
  if (!option.words.empty()) {
    action = fmt::format("({})", fmt::join(option.words, " "));
    if (option.is_file) {
      action = fmt::format("{{compadd -- {}; _files}}", fmt::join(option.words, " "));
    }
  }
  return fmt::format(":{}:{}", zsh_text(option.value), action);
}

std::string zsh_function(const CompletedCommand& command, const std::string& path) {
  std::string out = fmt::format("{}() {{\n", function_name(path, ""));
  if (!command.verbs.empty()) {
    out += "  local -a verbs=(\n";
    for (const CompletedCommand& verb : command.verbs) {
      out += fmt::format("    {}\n", quoted(verb.name + ":" + zsh_text(verb.help)));
    }
    out += "  )\n  local curcontext=$curcontext state line\n";
  }
  out += command.verbs.empty() ? "  _arguments -s" : "  _arguments -C";
  int n_positional = 0;
  for (const CompletedOption& option : command.options) {
    if (option.names.empty()) {
      ++n_positional;
      const std::string position =
          option.value.ends_with("...") ? "*" : std::to_string(n_positional);
      out += fmt::format(" \\\n    {}", quoted(position + zsh_value(option)));
      continue;
    }
    for (const std::string& word : option.names) {
      out += fmt::format(" \\\n    {}",
                         quoted(fmt::format("{}[{}]{}", "*" + word, zsh_text(option.help),
                                            option.value.empty() ? "" : zsh_value(option))));
    }
  }
  if (!command.verbs.empty()) {
    out += R"( \
    '1: :->verb' '*:: :->rest'
  case $state in
    verb) _describe verb verbs ;;
    rest)
      case $words[1] in
)";
    for (const CompletedCommand& verb : command.verbs) {
      out += fmt::format("        {}) {} ;;\n", verb.name,
                         function_name(path + " " + verb.name, ""));
    }
    out += "      esac ;;\n  esac";
  }
  return out + "\n}\n";
}

std::string for_zsh(const CompletedCommand& program) {
  std::string functions;
  visit(program, program.name,
        [&functions](const CompletedCommand& command, const std::string& path) {
          functions += zsh_function(command, path);
        });
  return fmt::format(
      "#compdef {0}\n# zsh completion of {0}, by {0} --completions zsh\n{1}{2} \"$@\"\n",
      program.name, functions, function_name(program.name, ""));
}

// ---- fish ----

/// `start`: what the lines of one command have in common.
std::string fish_lines(const CompletedCommand& command, const std::string& start) {
  std::string out;
  for (const CompletedCommand& verb : command.verbs) {
    out += fmt::format("{} -a {} -d {}\n", start, verb.name, quoted(verb.help, true));
  }
  for (const CompletedOption& option : command.options) {
    std::string line = start;
    for (const std::string& name : option.names) {
      line += name.starts_with("--") ? " -l " + name.substr(2) : " -s " + name.substr(1);
    }
    const std::string words = fmt::format("{}", fmt::join(option.words, " "));
    if (option.names.empty() && words.empty() && !option.is_file) {
      continue;  // a number: nothing to offer
    }
    if (!option.value.empty()) {
      line += option.is_file ? " -F" : "";
      line += option.names.empty() ? "" : (option.is_file ? " -r" : " -x");
      line += words.empty() ? "" : " -a " + quoted(words, true);
    }
    out += line + " -d " + quoted(option.help, true) + "\n";
  }
  return out;
}

std::string for_fish(const CompletedCommand& program) {
  const std::string at = "_" + function_name(program.name, "") + "_at";
  std::string out = fmt::format(
      "# fish completion of {0}, by {0} --completions fish\n"
      "function {1} # is the verb, \"rig doctor\" of many, the one that the line names?\n"
      "    set -l at ''\n"
      "    for word in (commandline -opc)[2..-1]\n"
      "        contains -- \"$at $word\" {2}; and set at \"$at $word\"\n"
      "    end\n"
      "    test \"$at\" = \"$argv\"\n"
      "end\n"
      "complete -c {0} -f\n",
      program.name, at, program.verbs.empty() ? "''" : verb_paths(program, " "));
  visit(program, "", [&](const CompletedCommand& command, const std::string& path) {
    out += fish_lines(command,
                      fmt::format("complete -c {} -n \"{} '{}'\"", program.name, at, path));
  });
  return out;
}

}  // namespace

std::string completions(const CompletedCommand& program, Shell shell) {
  switch (shell) {
    case Shell::bash:
      return for_bash(program);
    case Shell::zsh:
      return for_zsh(program);
    case Shell::fish:
      break;
  }
  return for_fish(program);
}

ValueKind value_kind(const std::string& name) {
  ValueKind kind;
  std::istringstream alternatives(name);
  for (std::string word; std::getline(alternatives, word, '|');) {
    if (word.ends_with("...")) {
      word.resize(word.size() - 3);
    }
    const std::size_t dot = word.find('.');
    const bool has_ending = dot != std::string::npos && dot + 1 < word.size() &&
                            std::isalpha(static_cast<unsigned char>(word[dot + 1])) != 0;
    if (has_ending ||
        std::find(std::begin(kFiles), std::end(kFiles), word) != std::end(kFiles)) {
      kind.is_file = true;
    } else if (std::all_of(word.begin(), word.end(),
                           [](unsigned char c) { return std::islower(c) != 0 || c == '-'; })) {
      kind.words.push_back(word);
    }
  }
  return kind;
}

}  // namespace haarlight::apps
