// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/light_choice.h"

#include <numbers>

namespace haarlight::relight {

render::Environment read_environment(const LightChoice& choice) {
  render::Environment environment = render::Environment::read(choice.cubemap);
  environment.rotate(choice.rotate_deg * std::numbers::pi / 180.0);
  return environment;
}

}  // namespace haarlight::relight
