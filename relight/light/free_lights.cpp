#include "relight/light/free_lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <Eigen/Dense>

#include "relight/light/light_terms.h"

namespace haarlight {

namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

/// Turns every axis towards `centre`. @return  the largest turn, rad
double aim_at(const Eigen::Vector3d& centre, std::vector<NearLight>& lights) {
  double most = 0.0;
  for (NearLight& light : lights) {
    const Eigen::Vector3d axis = (centre - light.position_mm).normalized();
    most = std::max(most, std::acos(std::clamp(axis.dot(light.axis), -1.0, 1.0)));
    light.axis = axis;
  }
  return most;
}

void give_size(double led_mm, std::vector<NearLight>& lights) {
  for (NearLight& light : lights) {
    const Eigen::Vector3d u = light.axis.unitOrthogonal();
    light.emitter_mm << led_mm * u, led_mm * light.axis.cross(u);
  }
}

}  // namespace

FreeLights find_free_lights(const TargetSamples& samples, const FreeLightOptions& options) {
  FreeLights out;
  CalibrationOptions each = options.lights;
  std::vector<NearLight> start = paper_start(samples, each.mu_start);
  give_size(options.led_mm, start);
  if (options.aim == Aim::everywhere) {
    each.lobe = Lobe::paper;
    out.lights = calibrate_free_lights(samples, std::move(start), each);
    out.n_rounds = 1;
    return out;
  }
  if (options.aim == Aim::down) {
    out.lights = calibrate_free_lights(samples, std::move(start), each);
    out.n_rounds = 1;
    add_aim_uncertainty(out.lights, samples, options.aim_sigma_deg);
    return out;
  }
  const Eigen::Vector3d centre = target_extent(samples).centre;
  each.lobe = Lobe::paper;
  out.is_settled = false;
  while (out.n_rounds < options.max_rounds && !out.is_settled) {
    out.lights = calibrate_free_lights(samples, start, each);
    for (std::size_t k = 0; k < start.size(); ++k) {
      start[k] = out.lights.lights[k].light;
    }
    out.last_turn_deg = aim_at(centre, start) / kDegree;
    give_size(options.led_mm, start);
    out.is_settled = out.n_rounds > 0 && out.last_turn_deg < options.settled_deg;
    each.start = Start::given;
    each.lobe = options.lights.lobe;
    each.mu_start = out.n_rounds == 0 ? options.lights.mu_start : std::max(out.lights.mu, 0.01);
    ++out.n_rounds;
  }
  add_aim_uncertainty(out.lights, samples, options.aim_sigma_deg);
  return out;
}

void add_aim_uncertainty(LightCalibration& found, const TargetSamples& samples,
                         double aim_sigma_deg) {
  if (!(aim_sigma_deg > 0.0)) {
    return;
  }
  const TargetColumns target(samples, found.sheet);
  for (std::size_t k = 0; k < found.lights.size(); ++k) {
    CalibratedLight& light = found.lights[k];
    if (light.finding == LightFinding::unseen || !(light.light.mu > 0.0)) {
      continue;
    }
    const std::uint8_t* used = samples.used(static_cast<int>(k));
    const LightTerms terms = light_terms(target, light.light, used, {.axis = true});
    const auto n = static_cast<Eigen::Index>(samples.n_points());
    Eigen::Matrix<double, Eigen::Dynamic, 4> place(n, 4);
    place.leftCols<3>() = terms.position.matrix();
    place.col(3).setOnes();
    const Eigen::Vector3d u = light.light.axis.unitOrthogonal();
    Eigen::Matrix<double, 3, 2> across;
    across << u, light.light.axis.cross(u);
    const Eigen::Matrix<double, Eigen::Dynamic, 2> axis = terms.axis.matrix() * across;
    // Weights of ln I: sigma^2 of I over I^2.
    Eigen::ArrayXd weight = Eigen::ArrayXd::Zero(n);
    for (Eigen::Index p = 0; p < n; ++p) {
      const auto value = static_cast<double>(samples.values(static_cast<int>(k))[p]);
      if (used[p] != 0 && value > 0.0 && terms.h[p] > 0.0) {
        weight[p] = value * value / samples.noise.variance(value);
      }
    }
    const Eigen::Matrix<double, 4, Eigen::Dynamic> weighted =
        (place.array().colwise() * weight).matrix().transpose();
    const Eigen::Matrix<double, 4, 2> moved =
        (weighted * place).ldlt().solve(weighted * axis) * (aim_sigma_deg * kDegree);
    light.sigma.position_mm2 += (moved * moved.transpose()).topLeftCorner<3, 3>();
    light.sigma.power = std::hypot(light.sigma.power, moved.row(3).norm());
  }
}

}  // namespace haarlight
