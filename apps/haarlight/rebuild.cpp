/// @file
/// `haarlight rebuild SESSION`: journal and session.json made again from the frames.

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "session/verify.h"

namespace haarlight {

void add_rebuild(CLI::App& root, Invocation& invocation) {
  auto folder = std::make_shared<std::string>();
  CLI::App* verb =
      root.add_subcommand("rebuild", "Make a session's journal and session.json again");
  verb->add_option("SESSION", *folder, "Session folder")->required();
  verb->footer(
      "Frames that hold are kept; others move to aside/ with the reason. Nothing is deleted.\n"
      "Exit code 75 when shots are missing: the capture can be continued.\n"
      "Example:\n  haarlight rebuild door.session");
  add_common_options(*verb, invocation);
  verb->callback([folder, &invocation] {
    invocation.command = "rebuild";
    invocation.run = [folder](Report& report) {
      report.add_input(*folder);
      DiskStorage storage;
      const RebuildReport rebuilt = rebuild_session(*folder, storage);
      report.add_reached("shots", std::int64_t{rebuilt.n_shots});
      report.add_reached("pending", std::int64_t{rebuilt.n_pending});
      report.add_reached("set_aside",
                         static_cast<std::int64_t>(rebuilt.recovery.set_aside.size()));
      for (const std::string& item : rebuilt.recovery.set_aside) {
        fmt::print("{}\n", item);
      }
      fmt::print("{}: {} of {} shots have a good frame{}\n", *folder,
                 rebuilt.n_shots - rebuilt.n_pending, rebuilt.n_shots,
                 rebuilt.n_pending == 0 ? "; session.json written" : "");
      return rebuilt.n_pending == 0 ? ExitCode::done : ExitCode::interrupted;
    };
  });
}

}  // namespace haarlight
