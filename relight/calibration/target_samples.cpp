// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/target_samples.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr const char* kWhere = "near-light calibration";

Eigen::Vector3d mean_over(const std::vector<Eigen::Vector3d>& all,
                          const std::vector<std::size_t>& block) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const std::size_t p : block) {
    sum += all[p];
  }
  return sum / static_cast<double>(block.size());
}

}  // namespace

void require_consistent(const TargetSamples& s) {
  const std::size_t n = s.n_points();
  const auto k = static_cast<std::size_t>(std::max(s.n_lights, 0));
  if (s.n_channels != 1 && s.n_channels != 3) {
    throw Error(fmt::format("{} channels", s.n_channels), kWhere, "give 1 or 3 channels");
  }
  if (s.normals.size() != n || s.is_used.size() != k * n ||
      s.intensity.size() != k * n * static_cast<std::size_t>(s.n_channels) ||
      (s.rows > 0 &&
       static_cast<std::size_t>(s.rows) * static_cast<std::size_t>(s.cols) != n)) {
    throw Error(fmt::format("{} lights x {} points, but {} normals, {} intensities, {} masks",
                            k, n, s.normals.size(), s.intensity.size(), s.is_used.size()),
                kWhere, "give every array its shape");
  }
  if ((!s.to_camera.empty() && s.to_camera.size() != n) ||
      (!s.lens_mm.empty() && s.lens_mm.size() != n)) {
    throw Error(fmt::format("{} points, but {} directions to the camera and {} lens shifts", n,
                            s.to_camera.size(), s.lens_mm.size()),
                kWhere, "give one for each point, or none");
  }
  for (std::size_t p = 0; p < n; ++p) {
    if (!s.points_mm[p].allFinite() || !(std::abs(s.normals[p].norm() - 1.0) < 1e-6)) {
      throw Error(fmt::format("point {} is not finite or its normal not of length 1", p),
                  kWhere, "check the target's geometry");
    }
  }
  for (std::size_t i = 0; i < s.intensity.size(); ++i) {
    if (!std::isfinite(s.intensity[i])) {
      throw Error(fmt::format("intensity {} is not a finite number", i), kWhere,
                  "develop the session again, or mask that sample with a finite value");
    }
  }
}

TargetExtent target_extent(const TargetSamples& s) {
  const std::size_t n = s.n_points();
  if (n < 3) {
    throw Error(fmt::format("a target of {} points", n), kWhere, "sample at least 3 points");
  }
  TargetExtent extent;
  Eigen::Vector3d low = s.points_mm.front();
  Eigen::Vector3d high = low;
  for (const Eigen::Vector3d& p : s.points_mm) {
    extent.centre += p / static_cast<double>(n);
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const Eigen::Vector3d& p : s.points_mm) {
    const Eigen::Vector2d d = (p - extent.centre).head<2>();
    spread += d * d.transpose();
  }
  if (!(spread.determinant() > 1e-9 * spread.trace() * spread.trace())) {
    throw Error("the target's points lie on one line", kWhere, "sample a surface");
  }
  extent.size_mm = std::max(high.x() - low.x(), high.y() - low.y());
  return extent;
}

std::vector<SampleCounts> mask_samples(TargetSamples& s, const MaskOptions& options) {
  const std::size_t n = s.n_points();
  // The brightest unsaturated sample, of each light and of all.
  std::vector<double> brightest(static_cast<std::size_t>(s.n_lights), 0.0);
  double of_all = 0.0;
  for (int k = 0; k < s.n_lights; ++k) {
    double& most = brightest[static_cast<std::size_t>(k)];
    for (std::size_t i = 0; i < n * static_cast<std::size_t>(s.n_channels); ++i) {
      const auto value = static_cast<double>(s.values(k)[i]);
      most = value < options.saturation && s.used(k)[i % n] != 0 ? std::max(most, value) : most;
    }
    of_all = std::max(of_all, most);
  }
  std::vector<SampleCounts> counts(static_cast<std::size_t>(s.n_lights));
  for (int k = 0; k < s.n_lights; ++k) {
    SampleCounts& c = counts[static_cast<std::size_t>(k)];
    const double dark = options.dark_fraction * std::max(brightest[static_cast<std::size_t>(k)],
                                                         options.dark_fraction * of_all);
    for (std::size_t p = 0; p < n; ++p) {
      std::uint8_t& used = s.is_used[static_cast<std::size_t>(k) * n + p];
      if (used == 0) {
        ++c.by_caller;
        continue;
      }
      bool is_saturated = false;
      bool is_dark = true;
      for (int ch = 0; ch < s.n_channels; ++ch) {
        const auto value = static_cast<double>(s.values(k, ch)[p]);
        is_saturated = is_saturated || value >= options.saturation;
        is_dark = is_dark && !(value > dark);
      }
      // A channel without light has no logarithm.
      for (int ch = 0; ch < s.n_channels; ++ch) {
        is_dark = is_dark || !(s.values(k, ch)[p] > 0.0F);
      }
      c.saturated += is_saturated ? 1 : 0;
      c.dark += is_dark && !is_saturated ? 1 : 0;
      used = is_saturated || is_dark ? 0 : 1;
      c.used += used;
    }
  }
  return counts;
}

TargetSamples coarse_samples(const TargetSamples& s, int factor) {
  HAARLIGHT_EXPECTS(factor >= 1, "a coarser grid");
  if (factor == 1) {
    return s;
  }
  TargetSamples out;
  out.n_lights = s.n_lights;
  out.n_channels = s.n_channels;
  out.noise = s.noise;
  std::vector<std::vector<std::size_t>> blocks;
  if (s.rows >= factor && s.cols >= factor) {
    out.rows = s.rows / factor;
    out.cols = s.cols / factor;
    for (int y = 0; y < out.rows; ++y) {
      for (int x = 0; x < out.cols; ++x) {
        std::vector<std::size_t>& block = blocks.emplace_back();
        for (int j = 0; j < factor * factor; ++j) {
          block.push_back(static_cast<std::size_t>(y * factor + j / factor) *
                              static_cast<std::size_t>(s.cols) +
                          static_cast<std::size_t>(x * factor + j % factor));
        }
      }
    }
    out.noise.relative /= factor;
    out.noise.shot /= factor * factor;
    out.noise.floor /= factor;
  } else {
    const auto step = static_cast<std::size_t>(factor) * static_cast<std::size_t>(factor);
    for (std::size_t p = step / 2; p < s.n_points(); p += step) {
      blocks.push_back({p});
    }
  }
  const std::size_t n = blocks.size();
  for (const std::vector<std::size_t>& block : blocks) {
    Eigen::Vector3d point = Eigen::Vector3d::Zero();
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (const std::size_t p : block) {
      point += s.points_mm[p] / static_cast<double>(block.size());
      normal += s.normals[p];
    }
    out.points_mm.push_back(point);
    out.normals.push_back(normal.normalized());
    if (!s.to_camera.empty()) {
      out.to_camera.push_back(mean_over(s.to_camera, block).normalized());
    }
    if (!s.lens_mm.empty()) {
      out.lens_mm.push_back(mean_over(s.lens_mm, block));
    }
  }
  out.intensity.resize(static_cast<std::size_t>(s.n_lights) *
                       static_cast<std::size_t>(s.n_channels) * n);
  out.is_used.resize(static_cast<std::size_t>(s.n_lights) * n);
  for (int k = 0; k < s.n_lights; ++k) {
    for (std::size_t b = 0; b < n; ++b) {
      out.is_used[static_cast<std::size_t>(k) * n + b] =
          std::all_of(blocks[b].begin(), blocks[b].end(),
                      [&](std::size_t p) { return s.used(k)[p] != 0; })
              ? 1
              : 0;
      for (int c = 0; c < s.n_channels; ++c) {
        double sum = 0.0;
        for (const std::size_t p : blocks[b]) {
          sum += static_cast<double>(s.values(k, c)[p]);
        }
        out.intensity[(static_cast<std::size_t>(k) * static_cast<std::size_t>(s.n_channels) +
                       static_cast<std::size_t>(c)) *
                          n +
                      b] = static_cast<float>(sum / static_cast<double>(blocks[b].size()));
      }
    }
  }
  return out;
}

TargetSamples simulate_target(std::span<const NearLight> lights,
                              const SimulatedTarget& target) {
  TargetSamples s;
  s.n_lights = static_cast<int>(lights.size());
  s.n_channels = target.n_channels;
  s.rows = target.rows;
  s.cols = target.cols;
  s.noise = {.relative = target.noise};
  const double pitch = target.size_mm / std::max(target.rows, target.cols);
  const double corner = 0.5 * pitch * std::hypot(target.rows, target.cols);
  std::vector<double> albedo;
  std::uint64_t at = 0;
  for (int y = 0; y < target.rows; ++y) {
    for (int x = 0; x < target.cols; ++x, ++at) {
      const double px = pitch * (x + 0.5 - 0.5 * target.cols);
      const double py = pitch * (0.5 * target.rows - y - 0.5);
      double z = 0.0;
      Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
      if (target.height) {
        const double h = 1e-4 * target.size_mm;  // central differences: error of order h^2
        z = target.height(px, py);
        n = Eigen::Vector3d((target.height(px - h, py) - target.height(px + h, py)) / (2 * h),
                            (target.height(px, py - h) - target.height(px, py + h)) / (2 * h),
                            1.0)
                .normalized();
      }
      s.points_mm.emplace_back(px, py, z);
      s.normals.push_back(n);
      const double away = std::hypot(px, py) / corner;
      albedo.push_back((1.0 - target.vignetting * away * away) *
                       (1.0 + target.albedo_spread *
                                  (2.0 * uniform_unit(hash_key(target.seed, 1, at)) - 1.0)));
    }
  }
  const std::size_t n = s.n_points();
  std::vector<double> values;
  values.reserve(lights.size() * static_cast<std::size_t>(target.n_channels) * n);
  double brightest = 0.0;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    std::vector<double> stencil(n);
    for (std::size_t p = 0; p < n; ++p) {
      stencil[p] = light_stencil(lights[k], s.points_mm[p], s.normals[p]);
    }
    for (int c = 0; c < target.n_channels; ++c) {
      for (std::size_t p = 0; p < n; ++p) {
        const double clean = albedo[p] * lights[k].power[c] * stencil[p];
        const double noise =
            target.noise *
            standard_normal(hash_key(target.seed, 2, k * 4 + static_cast<std::size_t>(c), p));
        values.push_back(clean * (1.0 + noise));
        brightest = std::max(brightest, values.back());
      }
    }
  }
  const double step = target.bits > 0 ? brightest / (std::pow(2.0, target.bits) - 1.0) : 0.0;
  s.intensity.reserve(values.size());
  for (double value : values) {
    if (step > 0.0) {
      value = step * std::round(value / step);
    }
    if (target.saturation > 0.0) {
      value = std::min(value, target.saturation);
    }
    s.intensity.push_back(static_cast<float>(value));
  }
  s.is_used.assign(lights.size() * n, 1);
  return s;
}

std::vector<NearLight> array_lights(int rows, int cols, double pitch_mm, double height_mm,
                                    double mu, double power_spread, std::uint64_t seed) {
  std::vector<NearLight> lights;
  double sum = 0.0;
  for (int row = 0; row < rows; ++row) {
    for (int col = 0; col < cols; ++col) {
      NearLight light;
      light.position_mm = {pitch_mm * (col - 0.5 * (cols - 1)),
                           pitch_mm * (row - 0.5 * (rows - 1)), height_mm};
      light.mu = mu;
      const double u = uniform_unit(hash_key(seed, 3, lights.size()));
      light.power = Eigen::Vector3d::Constant(1.0 + power_spread * (2.0 * u - 1.0));
      sum += light.power[0];
      lights.push_back(light);
    }
  }
  for (NearLight& light : lights) {
    light.power *= static_cast<double>(lights.size()) / sum;
  }
  return lights;
}

}  // namespace haarlight::relight
