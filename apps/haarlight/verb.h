// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "apps/command_line.h"
#include "core/report.h"
#include "haarlight/core/error.h"
#include "haarlight/core/progress.h"

/// @file
/// A verb of the `haarlight` command. Each has its own file with one function add_VERB;
/// verbs.cpp lists them.

namespace haarlight::apps {

/// Options that every verb has.
struct CommonOptions {
  std::string report;  ///< file; empty: none
  bool quiet = false;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  int threads = 0;  ///< 0: one a core
  bool force = false;

  [[nodiscard]] ProgressStyle progress() const { return choose_progress_style(quiet); }
};

/// What the command line requests: filled by the verb that it names.
struct Invocation {
  CommonOptions common;
  std::string command;
  std::function<ExitCode(Report& report)> run;
};

/// The work of a verb. It adds what was requested and achieved to the report.
using RunVerb = std::function<ExitCode(const CommonOptions& common, Report& report)>;

/// The last step of every add_VERB: adds --report, --quiet, --memory, --threads and --force
/// after the verb's own options, and has `run` called when the command line names the verb.
void finish_verb(Command verb, Invocation& invocation, RunVerb run);

/// "next: haarlight view out/cube.hlb" to the standard error, unless --quiet: how to see what a
/// verb has made, or what it is for.
/// @param words  of the command, without "haarlight"; quoted for a shell where they need it
void tell_next(const CommonOptions& common, const std::vector<std::string>& words);

/// Adds every verb of the table in verbs.cpp.
void add_all_verbs(Command root, Invocation& invocation);

}  // namespace haarlight::apps
