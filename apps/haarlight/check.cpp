/// @file
/// `haarlight check RIG`: reads a hand-written file and reports every problem in it.

#include <fmt/format.h>

#include "apps/haarlight/verb.h"
#include "core/rig.h"

namespace haarlight {

void add_check(Command root, Invocation& invocation) {
  auto file = std::make_shared<std::string>();
  Command verb = root.add_verb("check", "Check a rig file and list every problem in it");
  verb.option("RIG", file.get(), "Rig file", {.type = "RIG.toml", .is_required = true});
  verb.footer("Example:\n  haarlight check configs/rigs/cube32.toml");
  finish_verb(verb, invocation, [file](const CommonOptions&, Report& report) {
    report.add_input(*file);
    const Rig rig = read_rig(*file);
    report.add_reached("lights", std::int64_t{rig.n_lights()});
    fmt::print("{}: good. {} lights on {} faces, {} planes, {} cameras\n", *file,
               rig.n_lights(), rig.faces.size(), rig.planes.size(), rig.cameras.size());
    return ExitCode::done;
  });
}

}  // namespace haarlight
