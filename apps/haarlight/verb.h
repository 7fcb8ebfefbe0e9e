#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>

#include "core/error.h"
#include "core/progress.h"
#include "core/report.h"

namespace CLI {
class App;
}

/// @file
/// A verb of the `haarlight` command. Each has its own file with one function add_VERB;
/// verbs.cpp lists them.

namespace haarlight {

/// Options that every verb has.
struct CommonOptions {
  std::filesystem::path report;  ///< empty: none
  bool quiet = false;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  int threads = 0;  ///< 0: one a core
  bool force = false;

  [[nodiscard]] ProgressStyle progress() const { return choose_progress_style(quiet); }
};

/// What the command line asked for. A verb's CLI11 callback fills `command` and `run`.
struct Invocation {
  CommonOptions common;
  std::string command;
  std::function<ExitCode(Report& report)> run;
};

/// Adds --report, --quiet, --memory, --threads, --force to a verb.
void add_common_options(CLI::App& verb, Invocation& invocation);

/// Adds every verb of the table in verbs.cpp.
void add_all_verbs(CLI::App& root, Invocation& invocation);

}  // namespace haarlight
