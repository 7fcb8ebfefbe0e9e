// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/captured_lights.h"

namespace haarlight::relight {

CapturedLights::CapturedLights(const BasisFile& basis) {
  const BasisHeader& header = basis.header();
  if (!header.rig_toml.empty()) {
    rig_ = parse_rig(header.rig_toml, basis.name() + " (rig)");
    return;
  }
  directions_.reserve(header.lights.size());
  for (const BasisLight& light : header.lights) {
    directions_.push_back(light.coordinates.normalized());
  }
}

EnvironmentWeights CapturedLights::weights(const render::Environment& environment,
                                           double turn_rad) const {
  return rig_ ? rig_weights(environment, *rig_, turn_rad)
              : voronoi_weights(environment, directions_, turn_rad);
}

}  // namespace haarlight::relight
