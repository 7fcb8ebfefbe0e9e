#include "sim/rig_scene.h"

namespace haarlight {

std::vector<SquareLight> rig_lights(const Rig& rig) {
  std::vector<SquareLight> lights;
  for (const LightElement& element : light_elements(rig)) {
    SquareLight light;
    light.centre = element.centre;
    light.u = element.u;
    light.v = element.v;
    light.emits = element.emits;
    light.width_mm = element.width_mm;
    light.height_mm = element.height_mm;
    light.lobe_mu = element.lobe_mu;
    lights.push_back(light);
  }
  return lights;
}

}  // namespace haarlight
