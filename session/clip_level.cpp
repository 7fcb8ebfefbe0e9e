// SPDX-License-Identifier: Apache-2.0
#include "session/clip_level.h"

#include <cmath>

namespace haarlight::session {

double clip_level(const SensorNoise& noise, double black, double white) {
  constexpr double kUsableWell = 0.97;  // commissioning knows the full well to 3 %
  if (!(noise.full_well_e > 0.0) || !(noise.gain_e_per_dn > 0.0)) {
    return white;
  }
  const double well_dn = noise.full_well_e / noise.gain_e_per_dn;
  return black + well_dn < white - 1.0 ? black + kUsableWell * well_dn : white;
}

double clip_level(const CameraSpec& camera) {
  return clip_level(camera.noise, camera.noise.black_dn, std::exp2(camera.bits) - 1.0);
}

}  // namespace haarlight::session
