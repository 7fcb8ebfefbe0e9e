#include "relight/light/light_terms.h"

#include <algorithm>

#include "core/parallel.h"

namespace haarlight {

TargetColumns::TargetColumns(const TargetSamples& samples) {
  const auto n = static_cast<Eigen::Index>(samples.n_points());
  point.resize(n, 3);
  normal.resize(n, 3);
  for (Eigen::Index p = 0; p < n; ++p) {
    point.row(p) = samples.points_mm[static_cast<std::size_t>(p)].transpose();
    normal.row(p) = samples.normals[static_cast<std::size_t>(p)].transpose();
  }
}

LightTerms light_terms(const TargetColumns& target, const NearLight& light,
                       const std::uint8_t* used, bool has_axis) {
  const Eigen::Index n = target.point.rows();
  LightTerms t;
  Eigen::ArrayX3d w(n, 3);
  for (int c = 0; c < 3; ++c) {
    w.col(c) = light.position_mm[c] - target.point.col(c);
  }
  const Eigen::ArrayXd inverse_r2 = w.square().rowwise().sum().max(1e-300).inverse();
  Eigen::ArrayXd facing = (target.normal * w).rowwise().sum();
  Eigen::ArrayXd off =
      -(light.axis.x() * w.col(0) + light.axis.y() * w.col(1) + light.axis.z() * w.col(2));
  Eigen::ArrayXd lit = Eigen::ArrayXd::Ones(n);
  for (Eigen::Index p = 0; p < n; ++p) {
    const bool is_lit = facing[p] > 0.0 && (light.mu == 0.0 || off[p] > 0.0);
    if (!is_lit) {
      lit[p] = 0.0;
      t.reaches_used = t.reaches_used && used[p] == 0;
    }
    facing[p] = facing[p] > 0.0 ? facing[p] : 1.0;
    off[p] = off[p] > 0.0 ? off[p] : 1.0;
  }
  t.log_cos = 0.5 * (off.square() * inverse_r2).log();
  t.h = lit * facing * inverse_r2 * inverse_r2.sqrt();
  if (light.mu != 0.0) {
    t.h *= (light.mu * t.log_cos).exp();
  }
  // -d ln h / d l = (3 + mu) w / r^2 - n / (n.w) + mu axis / off
  const Eigen::ArrayXd per_off = light.mu * off.inverse();
  t.position.resize(n, 3);
  for (int c = 0; c < 3; ++c) {
    t.position.col(c) = target.normal.col(c) / facing -
                        (3.0 + light.mu) * w.col(c) * inverse_r2 - light.axis[c] * per_off;
  }
  if (has_axis) {
    t.axis = w.colwise() * Eigen::ArrayXd(-per_off);
  }
  return t;
}

std::vector<float> inverse_variances(const TargetSamples& samples, const TargetColumns& target,
                                     std::span<const NearLight> lights,
                                     std::span<const double> albedo) {
  const std::size_t n = samples.n_points();
  const auto n_channels = static_cast<std::size_t>(samples.n_channels);
  std::vector<float> out(lights.size() * n_channels * n);
  parallel_for(lights.size(), 8, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint8_t* used = samples.used(static_cast<int>(k));
      const LightTerms terms = light_terms(target, lights[k], used, false);
      for (std::size_t c = 0; c < n_channels; ++c) {
        for (std::size_t p = 0; p < n; ++p) {
          const double m = albedo[c * n + p] * lights[k].power[static_cast<Eigen::Index>(c)] *
                           terms.h[static_cast<Eigen::Index>(p)];
          const double variance = samples.noise.variance(m);
          out[(k * n_channels + c) * n + p] =
              used[p] != 0 && variance > 0.0 ? static_cast<float>(1.0 / variance) : 0.0F;
        }
      }
    }
  });
  return out;
}

LightResidual light_residual(const TargetSamples& samples, int light, const LightTerms& terms,
                             const Eigen::Vector3d& power, std::span<const double> albedo,
                             std::span<const float> inverse_variance) {
  const auto n = static_cast<Eigen::Index>(samples.n_points());
  LightResidual r{Eigen::ArrayXd::Zero(n), Eigen::ArrayXd::Zero(n)};
  for (int c = 0; c < samples.n_channels; ++c) {
    const auto at =
        static_cast<std::size_t>(light * samples.n_channels + c) * static_cast<std::size_t>(n);
    const Eigen::Map<const Eigen::ArrayXf> weight(inverse_variance.data() + at, n);
    const Eigen::Map<const Eigen::ArrayXf> intensity(samples.values(light, c), n);
    const Eigen::Map<const Eigen::ArrayXd> a(
        albedo.data() + static_cast<std::size_t>(c) * static_cast<std::size_t>(n), n);
    const Eigen::ArrayXd m = power[c] * a * terms.h;
    const Eigen::ArrayXd weighted_m = weight.cast<double>() * m;
    const Eigen::ArrayXd miss = intensity.cast<double>() - m;
    r.w += weighted_m * m;
    r.w_rho += weighted_m * miss;
    r.chi2 += (weight.cast<double>() * miss.square()).sum();
  }
  return r;
}

std::vector<bool> lights_in_use(const TargetSamples& samples) {
  std::vector<bool> in_use;
  for (int k = 0; k < samples.n_lights; ++k) {
    const std::uint8_t* used = samples.used(k);
    in_use.push_back(
        std::any_of(used, used + samples.n_points(), [](std::uint8_t u) { return u != 0; }));
  }
  return in_use;
}

void fix_power_scale(const TargetSamples& samples, std::span<NearLight> lights,
                     std::span<double> albedo) {
  const std::vector<bool> in_use = lights_in_use(samples);
  const auto n = samples.n_points();
  for (int c = 0; c < samples.n_channels; ++c) {
    double sum = 0.0;
    double count = 0.0;
    for (std::size_t k = 0; k < lights.size(); ++k) {
      sum += in_use[k] ? lights[k].power[c] : 0.0;
      count += in_use[k] ? 1.0 : 0.0;
    }
    const double scale = count > 0.0 && sum > 0.0 ? count / sum : 1.0;
    for (NearLight& light : lights) {
      light.power[c] *= scale;
      if (samples.n_channels == 1) {
        light.power = Eigen::Vector3d::Constant(light.power[0]);
      }
    }
    for (std::size_t p = 0; p < n; ++p) {
      albedo[static_cast<std::size_t>(c) * n + p] /= scale;
    }
  }
}

}  // namespace haarlight
