// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight verify SESSION`: re-checks every promise of a session.

#include "session/verify.h"

#include <cmath>

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/counted.h"

namespace haarlight::apps {

namespace {

ExitCode run_verify(const std::string& folder, const std::string& signers,
                    const CommonOptions& common, Report& report) {
  report.add_input(folder);
  const session::VerifyReport found =
      session::verify_session(folder, common.progress(), signers);
  report.add_detail("root", found.root);
  report.add_detail("signed_by", found.signed_by);
  report.add_achieved("shots", std::int64_t{found.n_shots});
  report.add_achieved("good_frames", std::int64_t{found.n_frames});
  report.add_achieved("suspect_frames", std::int64_t{found.n_suspect});
  report.add_achieved("light_by_word", std::int64_t{found.n_by_word});
  report.add_achieved("light_by_picture", std::int64_t{found.n_by_picture});
  report.add_achieved("problems", static_cast<std::int64_t>(found.problems.size()));
  report.add_achieved("least_margin_us", found.least_margin_us);
  for (const std::string& problem : found.problems) {
    fmt::print("{}\n", problem);
  }
  if (!common.quiet) {
    for (const std::string& note : found.notes) {
      fmt::print(stderr, "note: {}\n", note);
    }
  }
  const std::string margin =
      std::isfinite(found.least_margin_us)
          ? fmt::format(", least margin {:.1f} us", found.least_margin_us)
          : std::string(", evidence asserted");
  fmt::print("{}: {} of {} hold, {}{}\n", folder, found.n_frames,
             counted(found.n_shots, "frame"), counted(found.problems.size(), "problem"),
             margin);
  if (!found.root.empty()) {
    fmt::print("root {}{}{}\n", found.root, found.signed_by.empty() ? "" : "\n",
               found.signed_by);
  }
  if (found.n_by_word + found.n_by_picture > 0) {
    fmt::print(
        "{}: light proved by controller, clock and picture: {}; by controller and "
        "clock alone: {}\n",
        folder, counted(found.n_by_picture, "frame"), found.n_by_word);
  }
  return found.is_good() ? ExitCode::done : ExitCode::target_missed;
}

}  // namespace

void add_verify(Command root, Invocation& invocation) {
  auto folder = std::make_shared<std::string>();
  auto signers = std::make_shared<std::string>();
  Command verb = root.add_verb("verify", "Re-check every promise of a session");
  verb.option("SESSION", folder.get(), "Session folder", {.is_required = true});
  verb.option("--signers", signers.get(),
              "File of those who may sign (ssh-keygen's allowed_signers): the session must be "
              "signed by one of them");
  verb.footer(
      "Every byte is read and every hash, timestamp and clean margin is computed again.\n"
      "Unsigned this finds accident and careless editing, signed everything after signing.\n"
      "Sign: ssh-keygen -Y sign -f KEY -n haarlight SESSION/session.json\n"
      "Exit code 1 when a promise is broken; each is one line of output.\n"
      "Example:\n  haarlight verify door.session");
  finish_verb(verb, invocation, [folder, signers](const CommonOptions& common, Report& report) {
    return run_verify(*folder, *signers, common, report);
  });
}

}  // namespace haarlight::apps
