#include "render/rig_lights.h"

namespace haarlight {

SquareLight square_light(const LightElement& element) {
  SquareLight light;
  light.centre = element.centre;
  light.u = element.u;
  light.v = element.v;
  light.emits = element.emits;
  light.width_mm = element.width_mm;
  light.height_mm = element.height_mm;
  light.lobe_mu = element.lobe_mu;
  return light;
}

std::vector<SquareLight> rig_lights(const Rig& rig) {
  std::vector<SquareLight> lights;
  for (const LightElement& element : light_elements(rig)) {
    lights.push_back(square_light(element));
  }
  return lights;
}

}  // namespace haarlight
