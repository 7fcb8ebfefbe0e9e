/// @file
/// `haarlight check RIG`: reads a hand-written file and reports every problem in it.

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/rig.h"

namespace haarlight {

void add_check(CLI::App& root, Invocation& invocation) {
  auto file = std::make_shared<std::string>();
  CLI::App* verb =
      root.add_subcommand("check", "Check a rig file and list every problem in it");
  verb->add_option("RIG", *file, "Rig file")->required()->type_name("RIG.toml");
  verb->footer("Example:\n  haarlight check configs/rigs/cube32.toml");
  add_common_options(*verb, invocation);
  verb->callback([file, &invocation] {
    invocation.command = "check";
    invocation.run = [file](Report& report) {
      report.add_input(*file);
      const Rig rig = read_rig(*file);
      report.add_reached("lights", std::int64_t{rig.n_lights()});
      fmt::print("{}: good. {} lights on {} faces, {} planes, {} cameras\n", *file,
                 rig.n_lights(), rig.faces.size(), rig.planes.size(), rig.cameras.size());
      return ExitCode::done;
    };
  });
}

}  // namespace haarlight
