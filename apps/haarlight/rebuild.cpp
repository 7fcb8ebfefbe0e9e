// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight rebuild SESSION`: journal and session.json made again from the frames.

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/counted.h"
#include "session/verify.h"

namespace haarlight::apps {

void add_rebuild(Command root, Invocation& invocation) {
  auto folder = std::make_shared<std::string>();
  Command verb = root.add_verb("rebuild", "Make a session's journal and session.json again");
  verb.option("SESSION", folder.get(), "Session folder", {.is_required = true});
  verb.footer(
      "Frames that hold are kept; others move to aside/ with the reason. Nothing is deleted.\n"
      "Exit code 75 when shots are missing: the capture can be continued.\n"
      "Example:\n  haarlight rebuild door.session");
  finish_verb(verb, invocation, [folder](const CommonOptions&, Report& report) {
    report.add_input(*folder);
    session::DiskStorage storage;
    const session::RebuildReport rebuilt = session::rebuild_session(*folder, storage);
    report.add_achieved("shots", std::int64_t{rebuilt.n_shots});
    report.add_achieved("pending", std::int64_t{rebuilt.n_pending});
    report.add_achieved("set_aside",
                        static_cast<std::int64_t>(rebuilt.recovery.set_aside.size()));
    for (const std::string& item : rebuilt.recovery.set_aside) {
      fmt::print("{}\n", item);
    }
    fmt::print("{}: {} of {} a good frame{}\n", *folder, rebuilt.n_shots - rebuilt.n_pending,
               counted(rebuilt.n_shots, "shot has", "shots have"),
               rebuilt.n_pending == 0 ? "; session.json written" : "");
    return rebuilt.n_pending == 0 ? ExitCode::done : ExitCode::interrupted;
  });
}

}  // namespace haarlight::apps
