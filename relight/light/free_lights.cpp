#include "relight/light/free_lights.h"

#include <cstddef>
#include <numbers>
#include <utility>

namespace haarlight {

namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

}  // namespace

LightCalibration find_free_lights(const TargetSamples& samples,
                                  const FreeLightOptions& options) {
  CalibrationOptions each = options.lights;
  std::vector<NearLight> start = paper_start(samples, each.mu_start);
  // Straight down is towards a point so far below that no light's place matters.
  constexpr double kFarBelow = 1e8;
  const Eigen::Vector3d centre = target_extent(samples).centre;
  const Eigen::Vector3d aim =
      options.aim == Aim::centre ? centre : Eigen::Vector3d(centre.x(), centre.y(), -kFarBelow);
  for (NearLight& light : start) {
    light.emitter_mm << options.led_mm, 0.0, 0.0, options.led_mm, 0.0, 0.0;
    if (options.aim != Aim::everywhere) {
      light.aim_mm = aim;
    }
  }
  if (options.aim == Aim::everywhere) {
    each.lobe = Lobe::paper;
  } else {
    each.aim_sigma = options.aim_sigma_deg * kDegree;
  }
  if (each.aim_sigma > 0.0 && each.lobe == Lobe::free) {
    // Axes that are off pull a free exponent away before they are unknowns themselves.
    CalibrationOptions first = each;
    first.lobe = Lobe::given;
    const LightCalibration found = calibrate_free_lights(samples, start, first);
    for (std::size_t k = 0; k < start.size(); ++k) {
      start[k] = found.lights[k].light;
    }
    each.start = Start::given;
  }
  return calibrate_free_lights(samples, std::move(start), each);
}

}  // namespace haarlight
