// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/light_choice.h"

#include <numbers>
#include <span>

#include "core/picture/picture_bytes.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {

render::Environment read_environment(const LightChoice& choice) {
  render::Environment environment = render::Environment::read(choice.cubemap);
  environment.rotate(choice.rotate_deg * std::numbers::pi / 180.0);
  return environment;
}

render::Environment environment_from_bytes(std::string_view bytes, const std::string& name) {
  return render::Environment::from_picture(
      linear_light(read_picture_bytes(std::as_bytes(std::span(bytes)), name), name), name);
}

}  // namespace haarlight::relight
