/// @file
/// The table of verbs, in the order of a job.

#include <CLI/CLI.hpp>

#include "apps/haarlight/verb.h"

namespace haarlight {

void add_check(CLI::App& root, Invocation& invocation);
void add_plan(CLI::App& root, Invocation& invocation);
void add_capture(CLI::App& root, Invocation& invocation);
void add_status(CLI::App& root, Invocation& invocation);
void add_pause(CLI::App& root, Invocation& invocation);
void add_resume(CLI::App& root, Invocation& invocation);
void add_abort(CLI::App& root, Invocation& invocation);
void add_all_off(CLI::App& root, Invocation& invocation);
void add_reshoot(CLI::App& root, Invocation& invocation);
void add_import(CLI::App& root, Invocation& invocation);
void add_verify(CLI::App& root, Invocation& invocation);
void add_rebuild(CLI::App& root, Invocation& invocation);
void add_develop(CLI::App& root, Invocation& invocation);
void add_export(CLI::App& root, Invocation& invocation);
void add_plate(CLI::App& root, Invocation& invocation);
void add_compress(CLI::App& root, Invocation& invocation);
void add_relight(CLI::App& root, Invocation& invocation);
void add_shadow(CLI::App& root, Invocation& invocation);

namespace {

using AddVerb = void (*)(CLI::App& root, Invocation& invocation);

constexpr AddVerb kVerbs[] = {
    // clang-format off: one a line, so that two additions do not meet
    add_check,   add_plan,    add_capture, add_status,   add_pause,   add_resume,
    add_abort,   add_all_off, add_reshoot, add_import,   add_verify,  add_rebuild,
    add_develop, add_export,  add_plate,   add_compress, add_relight, add_shadow,
    // clang-format on
};

}  // namespace

void add_common_options(CLI::App& verb, Invocation& invocation) {
  CommonOptions& common = invocation.common;
  verb.add_option("--report", common.report, "Write what was asked and reached as JSON")
      ->type_name("FILE");
  verb.add_flag("--quiet,-q", common.quiet, "No progress, only results and errors");
  verb.add_option("--memory", common.memory_bytes, "Memory budget, for example 512M or 4G")
      ->transform(CLI::AsSizeValue(false))
      ->default_str("4G");
  verb.add_option("--threads", common.threads, "Threads to use (default: one a core)")
      ->check(CLI::Range(1, 1024));
  verb.add_flag("--force", common.force, "Overwrite an existing output");
}

void add_all_verbs(CLI::App& root, Invocation& invocation) {
  for (const AddVerb add : kVerbs) {
    add(root, invocation);
  }
}

}  // namespace haarlight
