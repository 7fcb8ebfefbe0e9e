// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/light_options.h"

#include <numbers>

namespace haarlight {

void add_light_options(Command verb, LightOptions& options) {
  verb.option("--cubemap,--environment", &options.cubemap,
              "Environment: lat-long, cross or strip picture, or a folder of six faces",
              {.type = "ENV"});
  verb.option("--light,--lights", &options.lights,
              "A light by number, or NUMBER=DRIVE; repeat it or separate with commas",
              {.type = "K[=W]"});
  verb.option("--rotate", &options.rotate_deg,
              "Turn the environment about z, degrees, counter-clockwise from above");
}

Environment read_environment(const LightOptions& options, Report& report) {
  Environment environment = Environment::read(options.cubemap);
  environment.rotate(options.rotate_deg * std::numbers::pi / 180.0);
  report.add_input(options.cubemap);
  report.add_asked("rotate_deg", options.rotate_deg);
  report.add_detail("layout", std::string(to_string(environment.layout())));
  return environment;
}

}  // namespace haarlight
