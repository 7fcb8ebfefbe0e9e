// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/light_options.h"

namespace haarlight::apps {

void add_light_options(Command verb, relight::LightChoice& choice) {
  verb.option("--cubemap,--environment", &choice.cubemap,
              "Environment: lat-long, cross or strip picture, or a folder of six faces",
              {.type = "ENV"});
  verb.option("--light,--lights", &choice.lights,
              "A light by number, or NUMBER=DRIVE; repeat it or separate with commas",
              {.type = "K[=W]"});
  verb.option("--rotate", &choice.rotate_deg,
              "Turn the environment about z, degrees, counter-clockwise from above");
}

}  // namespace haarlight::apps
