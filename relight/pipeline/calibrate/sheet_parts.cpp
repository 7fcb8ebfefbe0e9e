// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/calibrate/sheet_parts.h"

#include <algorithm>
#include <limits>
#include <span>

#include <fmt/format.h>

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

SheetPriors priors_of(const CalibratePipelineOptions& options) {
  SheetPriors priors = matte_paper(true);
  for (const SheetTerm term : {SheetTerm::bow_xx, SheetTerm::bow_xy, SheetTerm::bow_yy}) {
    priors.sigma[term] = options.sheet.bow_mm;
  }
  return priors;
}

double fraction_used(const SampleCounts& c) {
  const auto all = static_cast<double>(c.used + c.saturated + c.dark + c.shadowed + c.outlying +
                                       c.by_caller);
  return all > 0.0 ? static_cast<double>(c.used) / all : 0.0;
}

Image<float> albedo_picture(const TargetSamples& samples, const std::vector<double>& albedo) {
  Image<float> out(samples.rows, samples.cols, samples.n_channels == 3 ? 3 : 1);
  const std::size_t n = samples.n_points();
  for (int y = 0; y < out.height(); ++y) {
    for (int x = 0; x < out.width(); ++x) {
      for (int c = 0; c < out.channels(); ++c) {
        out(y, x, c) = static_cast<float>(
            albedo[static_cast<std::size_t>(c) * n +
                   static_cast<std::size_t>(y) * static_cast<std::size_t>(out.width()) +
                   static_cast<std::size_t>(x)]);
      }
    }
  }
  return out;
}

}  // namespace

CalibrationOptions sheet_calibration_options(const CalibratePipelineOptions& options) {
  CalibrationOptions calibration;
  calibration.mask.saturation =
      std::numeric_limits<double>::max();  // the sampler has masked them
  calibration.lobe = options.sheet.lobe;
  calibration.mu_start = options.sheet.mu;
  calibration.sheet = priors_of(options);
  return calibration;
}

FreeLightOptions free_light_options(const CalibratePipelineOptions& options) {
  FreeLightOptions lights;
  lights.aim = options.sheet.aim;
  lights.aim_sigma_deg = options.sheet.aim_deg;
  lights.led_mm = options.sheet.led_mm;
  lights.lights = sheet_calibration_options(options);
  return lights;
}

FoundLight found_light(const CalibratedLight& light, const std::string& name, bool is_known) {
  FoundLight out;
  out.name = name;
  out.used = fraction_used(light.counts);
  if (light.finding == LightFinding::unseen) {
    const SampleCounts& c = light.counts;
    out.finding = fmt::format("unseen: {} dark, {} saturated, {} shadowed, {} outlying blocks",
                              c.dark, c.saturated, c.shadowed, c.outlying + c.by_caller);
    return out;
  }
  if (light.finding == LightFinding::weak) {
    const Vector3d& d = light.weak_direction;
    out.finding = is_known ? fmt::format("weak: +- {:.3g} mm along ({:.2f}, {:.2f}, {:.2f})",
                                         light.weak_mm, d.x(), d.y(), d.z())
                           : "weak";
  }
  out.position_mm = light.light.position_mm;
  out.direction = light.light.position_mm.normalized();
  out.power = light.light.power;
  out.lobe = session::LightLobe{light.light.axis, light.light.mu};
  if (is_known) {
    out.sigma_mm = light.sigma.position_mm2.diagonal().cwiseSqrt();
    out.sigma_deg = direction_sigma_deg(light.light.position_mm, light.sigma.position_mm2);
    out.power_sigma = light.sigma.power;
  }
  return out;
}

void add_lights(const LightCalibration& fit, const LightPictures& pictures, bool is_known,
                FoundLights& found) {
  for (std::size_t k = 0; k < fit.lights.size(); ++k) {
    found.lights.push_back(found_light(fit.lights[k], pictures.names()[k], is_known));
    if (pictures.session() != nullptr && !pictures.session()->rig()) {
      found.lights.back().power *= pictures.session()->info().lights[k].relative_power;
    }
  }
}

void add_sheet_picture(const TargetSamples& samples, const std::vector<double>& albedo,
                       FoundLights& found) {
  found.picture = albedo_picture(samples, albedo);
  found.picture_name = "sheet.png";
  const std::span<const float> pixels = found.picture.pixels();
  const float most = *std::max_element(pixels.begin(), pixels.end());
  found.picture_exposure = most > 0.0F ? 0.95 / static_cast<double>(most) : 1.0;
}

}  // namespace haarlight::relight
