// SPDX-License-Identifier: Apache-2.0
/// @file
/// The table of verbs, in the order of a job.

#include <cstdio>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::apps {

void add_check(Command root, Invocation& invocation);
void add_advise(Command root, Invocation& invocation);
void add_plan(Command root, Invocation& invocation);
void add_capture(Command root, Invocation& invocation);
void add_status(Command root, Invocation& invocation);
void add_pause(Command root, Invocation& invocation);
void add_resume(Command root, Invocation& invocation);
void add_abort(Command root, Invocation& invocation);
void add_all_off(Command root, Invocation& invocation);
void add_reshoot(Command root, Invocation& invocation);
void add_cameras(Command root, Invocation& invocation);
void add_rig(Command root, Invocation& invocation);
void add_preview(Command root, Invocation& invocation);
void add_shot(Command root, Invocation& invocation);
void add_sessions(Command root, Invocation& invocation);
void add_import(Command root, Invocation& invocation);
void add_calibrate(Command root, Invocation& invocation);
void add_verify(Command root, Invocation& invocation);
void add_rebuild(Command root, Invocation& invocation);
void add_develop(Command root, Invocation& invocation);
void add_export(Command root, Invocation& invocation);
void add_convert(Command root, Invocation& invocation);
void add_plate(Command root, Invocation& invocation);
void add_compress(Command root, Invocation& invocation);
void add_relight(Command root, Invocation& invocation);
void add_bases(Command root, Invocation& invocation);
void add_fit(Command root, Invocation& invocation);
void add_shadow(Command root, Invocation& invocation);
void add_hull(Command root, Invocation& invocation);
void add_serve(Command root, Invocation& invocation);
void add_view(Command root, Invocation& invocation);
void add_publish(Command root, Invocation& invocation);
void add_correct(Command root, Invocation& invocation);
void add_shape(Command root, Invocation& invocation);
void add_mesh(Command root, Invocation& invocation);
void add_render(Command root, Invocation& invocation);

namespace {

using AddVerb = void (*)(Command root, Invocation& invocation);

constexpr AddVerb kVerbs[] = {
    // One per line, so that two additions do not meet.
    // clang-format off
    add_check,
    add_advise,
    add_plan,
    add_capture,
    add_status,
    add_pause,
    add_resume,
    add_abort,
    add_all_off,
    add_reshoot,
    add_cameras,
    add_rig,
    add_preview,
    add_shot,
    add_sessions,
    add_import,
    add_calibrate,
    add_verify,
    add_rebuild,
    add_develop,
    add_export,
    add_convert,
    add_plate,
    add_compress,
    add_relight,
    add_serve,
    add_view,
    add_publish,
    add_bases,
    add_fit,
    add_shadow,
    add_hull,
    add_correct,
    add_shape,
    add_mesh,
    add_render,
    // clang-format on
};

constexpr std::string_view kPlainInShell =
    "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_@%+=:,./-";

std::string quote_for_shell(const std::string& word) {
  if (!word.empty() && word.find_first_not_of(kPlainInShell) == std::string::npos) {
    return word;
  }
  std::string quoted = "'";
  for (const char c : word) {
    quoted += c == '\'' ? std::string(R"('\'')") : std::string(1, c);
  }
  return quoted + "'";
}

}  // namespace

void finish_verb(Command verb, Invocation& invocation, RunVerb run) {
  CommonOptions& common = invocation.common;
  verb.option("--report", &common.report, "Write what was requested and achieved as JSON",
              {.type = "FILE"});
  verb.flag("--quiet,-q", &common.quiet, "No progress, only results and errors");
  verb.option("--memory", &common.memory_bytes, "Memory budget, for example 512M or 4G",
              {.default_text = "4G", .is_bytes = true});
  verb.option("--threads", &common.threads, "Threads to use (default: one a core)",
              {.bounds = Bounds{1, 1024}});
  verb.flag("--force", &common.force, "Overwrite an existing output");
  // A nested verb reports and complains as the one that holds it: "rig".
  const std::string words = verb.name();
  verb.on_chosen([name = words.substr(0, words.find(' ')), run = std::move(run), &invocation] {
    invocation.command = name;
    invocation.run = [run, &invocation](Report& report) {
      limit_picture_memory(invocation.common.memory_bytes);
      return run(invocation.common, report);
    };
  });
}

void tell_next(const CommonOptions& common, const std::vector<std::string>& words) {
  if (common.quiet) {
    return;
  }
  std::string line = "next: haarlight";
  for (const std::string& word : words) {
    line += ' ' + quote_for_shell(word);
  }
  fmt::print(stderr, "{}\n", line);
}

void add_all_verbs(Command root, Invocation& invocation) {
  for (const AddVerb add : kVerbs) {
    add(root, invocation);
  }
}

}  // namespace haarlight::apps
