// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight VERB INPUT...`: reads the command line, runs one verb, turns every failure into a
/// message and an exit code.

#include <cstdio>
#include <exception>
#include <new>
#include <optional>

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "apps/program_version.h"
#include "core/log.h"
#include "core/mapped_files.h"
#include "core/parallel.h"
#include "haarlight/core/files.h"

namespace {

int run_verb(haarlight::apps::Invocation& invocation) {
  using haarlight::ExitCode;
  const haarlight::apps::CommonOptions& common = invocation.common;
  if (common.quiet) {
    haarlight::set_log_level(haarlight::LogLevel::error);
  }
  std::optional<haarlight::ThreadLimit> limit;
  if (common.threads > 0) {
    limit.emplace(common.threads);
  }
  haarlight::Report report(invocation.command);
  if (!common.report.empty()) {
    haarlight::require_absent(common.report, common.force);
  }
  const ExitCode code = invocation.run(report);
  if (!common.report.empty()) {
    report.write(common.report);
  }
  return static_cast<int>(code);
}

int run_guarded(haarlight::apps::Invocation& invocation) {
  using haarlight::ExitCode;
  try {
    return run_verb(invocation);
  } catch (const haarlight::Error& error) {
    fmt::print(stderr, "haarlight {}: {}\n", invocation.command, error.what());
    return static_cast<int>(error.code());
  } catch (const std::bad_alloc&) {
    fmt::print(
        stderr,
        "haarlight {}: out of memory\n  hint: give a smaller --memory or a larger machine\n",
        invocation.command);
    return static_cast<int>(ExitCode::internal);
  } catch (const std::exception& error) {
    fmt::print(stderr, "haarlight {}: {}\n  hint: this is our own bug, please report it\n",
               invocation.command, error.what());
    return static_cast<int>(ExitCode::internal);
  }
}

}  // namespace

int main(int argc, char** argv) try {
  haarlight::end_where_mapped_files_fail("haarlight");
  haarlight::apps::CommandLine line(
      "haarlight", "haarlight: capture an object under every light, and relight it afterwards",
      haarlight::apps::program_version());
  line.root().require_verb();
  haarlight::apps::Invocation invocation;
  haarlight::apps::add_all_verbs(line.root(), invocation);
  if (const std::optional<haarlight::ExitCode> end = line.parse(argc, argv)) {
    return static_cast<int>(*end);
  }
  return run_guarded(invocation);
} catch (const std::exception& error) {
  std::fputs(error.what(), stderr);
  return static_cast<int>(haarlight::ExitCode::internal);
}
