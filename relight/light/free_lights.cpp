#include "relight/light/free_lights.h"

#include <cmath>
#include <cstddef>
#include <numbers>
#include <utility>

#include "core/error.h"

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

void add_deviation(LightCalibration& found, const LightCalibration& moved) {
  HAARLIGHT_EXPECTS(found.lights.size() == moved.lights.size(), "the same lights");
  for (std::size_t k = 0; k < found.lights.size(); ++k) {
    CalibratedLight& light = found.lights[k];
    const NearLight& other = moved.lights[k].light;
    if (light.finding == LightFinding::unseen) {
      continue;
    }
    const Eigen::Vector3d d = other.position_mm - light.light.position_mm;
    light.sigma.position_mm2 += d * d.transpose();
    light.sigma.power =
        std::hypot(light.sigma.power, std::log(other.power[0] / light.light.power[0]));
  }
}

}  // namespace haarlight
