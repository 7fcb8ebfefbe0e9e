// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/free_lights.h"

#include <cmath>
#include <cstddef>
#include <numbers>
#include <utility>
#include <vector>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

/// The fit that precedes the fit of everything.
enum class FirstFit {
  lobe_held,  ///< wrong axes would bias a free exponent before they become unknowns
  isotropic,  ///< without a lobe: it hardly varies for a light aimed at the middle
  none,
};

LightCalibration fit_from(const TargetSamples& samples, std::vector<NearLight> start,
                          CalibrationOptions options, FirstFit way) {
  const bool has_aim = options.aim_sigma > 0.0 && options.lobe == Lobe::free;
  if ((way == FirstFit::lobe_held && has_aim) || way == FirstFit::isotropic) {
    CalibrationOptions first = options;
    first.lobe = way == FirstFit::isotropic ? Lobe::paper : Lobe::given;
    if (way == FirstFit::isotropic) {
      first.aim_sigma = 0.0;
      first.sheet = {};
    }
    const LightCalibration found = calibrate_free_lights(samples, start, first);
    for (std::size_t k = 0; k < start.size(); ++k) {
      const double mu = start[k].mu;
      start[k] = found.lights[k].light;
      start[k].mu = mu;
    }
    options.start = Start::given;
  }
  return calibrate_free_lights(samples, std::move(start), options);
}

}  // namespace

LightCalibration find_free_lights(const TargetSamples& samples,
                                  const FreeLightOptions& options) {
  CalibrationOptions each = options.lights;
  std::vector<NearLight> start = paper_start(samples, each.mu_start);
  // Straight down is towards a point so far below that no light's position matters.
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
  // A wrong axis, or a lobe far from the start's, can lead to another local minimum. Where the
  // model explains the pictures, nothing else is tried.
  LightCalibration best = fit_from(samples, start, each, FirstFit::lobe_held);
  for (const FirstFit way : {FirstFit::none, FirstFit::isotropic}) {
    if (best.test.is_passed() || options.aim == Aim::everywhere) {
      break;
    }
    LightCalibration other = fit_from(samples, start, each, way);
    if (other.reduced_chi2 < best.reduced_chi2) {
      best = std::move(other);
    }
  }
  return best;
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

}  // namespace haarlight::relight
