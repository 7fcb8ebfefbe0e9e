// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/variance_objective.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr int kBlock =
    16;  // points at a time: K x kBlock numbers of each kind stay in the cache
using Lane = Eigen::Array<double, kBlock, 1>;

/// One block of points, as lanes. Lanes past the end repeat the last point, unused.
struct Points {
  Lane x, y, z, nx, ny, nz;
};

/// Light on the block from one light.
struct Rays {
  Lane wx, wy, wz;  ///< from the point to the light, mm
  Lane inverse_r2, inverse_facing, inverse_off;
  Lane log_cos;  ///< of the lobe's angle
  Lane used;     ///< 1 or 0
  std::array<Lane, 3> a;
};

struct Partial {
  double d = 0.0;
  VarianceGradient gradient;
};

class Evaluation {
 public:
  Evaluation(const TargetSamples& samples, std::span<const NearLight> lights, bool has_gradient)
      : samples_(samples), lights_(lights), has_gradient_(has_gradient) {}

  VarianceValue run() {
    const std::size_t n = samples_.n_points();
    const std::size_t n_blocks = (n + kBlock - 1) / kBlock;
    std::vector<Partial> partial(n_blocks);
    parallel_for(n_blocks, 1, [&](std::size_t begin, std::size_t end) {
      std::vector<Rays> rays(lights_.size());
      for (std::size_t b = begin; b < end; ++b) {
        partial[b] = block(b * kBlock, rays);
      }
    });
    VarianceValue value;
    const std::size_t n_used = count_points();
    if (is_behind_ || n_used == 0) {
      return value;
    }
    const double scale = 1.0 / static_cast<double>(n_used);
    value.d = 0.0;
    for (const Partial& p : partial) {
      value.d += scale * p.d;
    }
    if (!has_gradient_) {
      return value;
    }
    VarianceGradient& sum = value.gradient;
    sum.position.assign(lights_.size(), Eigen::Vector3d::Zero());
    sum.axis = sum.position;
    sum.log_power.assign(lights_.size() * static_cast<std::size_t>(samples_.n_channels), 0.0);
    for (const Partial& p : partial) {
      for (std::size_t k = 0; k < lights_.size(); ++k) {
        sum.position[k] += 2.0 * scale * p.gradient.position[k];
        sum.axis[k] += 2.0 * scale * p.gradient.axis[k];
      }
      for (std::size_t i = 0; i < sum.log_power.size(); ++i) {
        sum.log_power[i] += 2.0 * scale * p.gradient.log_power[i];
      }
      sum.mu += 2.0 * scale * p.gradient.mu;
    }
    return value;
  }

 private:
  [[nodiscard]] std::size_t count_points() const {
    std::size_t count = 0;
    for (std::size_t p = 0; p < samples_.n_points(); ++p) {
      int used = 0;
      for (int k = 0; k < samples_.n_lights && used < 2; ++k) {
        used += samples_.used(k)[p] != 0 ? 1 : 0;
      }
      count += used >= 2 ? 1 : 0;
    }
    return count;
  }

  [[nodiscard]] Points load(std::size_t first) const {
    Points points;
    const std::size_t last = samples_.n_points() - 1;
    for (int j = 0; j < kBlock; ++j) {
      const std::size_t p = std::min(first + static_cast<std::size_t>(j), last);
      points.x[j] = samples_.points_mm[p].x();
      points.y[j] = samples_.points_mm[p].y();
      points.z[j] = samples_.points_mm[p].z();
      points.nx[j] = samples_.normals[p].x();
      points.ny[j] = samples_.normals[p].y();
      points.nz[j] = samples_.normals[p].z();
    }
    return points;
  }

  /// A = I g / e and the factors of its derivative. An unused sample gets harmless ones.
  void trace(std::size_t first, const Points& points, std::size_t k, Rays& r) {
    const NearLight& light = lights_[k];
    const std::size_t n = samples_.n_points();
    const int count = static_cast<int>(std::min<std::size_t>(kBlock, n - first));
    const std::uint8_t* used = samples_.used(static_cast<int>(k)) + first;
    for (int j = 0; j < kBlock; ++j) {
      r.used[j] = j < count && used[j] != 0 ? 1.0 : 0.0;
    }
    r.wx = light.position_mm.x() - points.x;
    r.wy = light.position_mm.y() - points.y;
    r.wz = light.position_mm.z() - points.z;
    const Lane r2 = r.wx.square() + r.wy.square() + r.wz.square();
    Lane facing = points.nx * r.wx + points.ny * r.wy + points.nz * r.wz;
    Lane off = -(light.axis.x() * r.wx + light.axis.y() * r.wy + light.axis.z() * r.wz);
    const bool has_lobe = light.mu != 0.0 || has_gradient_;
    for (int j = 0; j < kBlock; ++j) {
      const bool is_lit = facing[j] > 0.0 && (light.mu == 0.0 || off[j] > 0.0);
      if (!is_lit && r.used[j] != 0.0) {
        is_behind_ = true;
      }
      facing[j] = facing[j] > 0.0 ? facing[j] : 1.0;
      off[j] = off[j] > 0.0 ? off[j] : 1.0;
    }
    r.inverse_r2 = r2.max(1e-300).inverse();
    r.inverse_facing = facing.inverse();
    r.inverse_off = off.inverse();
    Lane g = r2 * r2.sqrt() * r.inverse_facing;
    if (has_lobe) {
      r.log_cos = 0.5 * (off.square() * r.inverse_r2).log();
      g *= (-light.mu * r.log_cos).exp();
    }
    for (int c = 0; c < samples_.n_channels; ++c) {
      Lane intensity = Lane::Zero();
      const float* values = samples_.values(static_cast<int>(k), c) + first;
      for (int j = 0; j < count; ++j) {
        intensity[j] = r.used[j] != 0.0 ? static_cast<double>(values[j]) : 0.0;
      }
      r.a[static_cast<std::size_t>(c)] = intensity * g / light.power[c];
    }
  }

  Partial block(std::size_t first, std::vector<Rays>& rays) {
    const std::size_t n_lights = lights_.size();
    const auto n_channels = static_cast<std::size_t>(samples_.n_channels);
    const Points points = load(first);
    Lane used = Lane::Zero();
    std::array<Lane, 3> s1{Lane::Zero(), Lane::Zero(), Lane::Zero()};
    std::array<Lane, 3> s2 = s1;
    for (std::size_t k = 0; k < n_lights; ++k) {
      trace(first, points, k, rays[k]);
      used += rays[k].used;
      for (std::size_t c = 0; c < n_channels; ++c) {
        s1[c] += rays[k].a[c];
        s2[c] += rays[k].a[c].square();
      }
    }
    Partial out;
    // Points with fewer than two lights, and black ones, have no variance.
    std::array<Lane, 3> per_s2;
    std::array<Lane, 3> factor;  // S1 / (K S2)
    for (std::size_t c = 0; c < n_channels; ++c) {
      for (int j = 0; j < kBlock; ++j) {
        const bool counts = used[j] >= 2.0 && s2[c][j] > 0.0;
        per_s2[c][j] = counts ? 1.0 / s2[c][j] : 0.0;
        factor[c][j] = counts ? s1[c][j] / (used[j] * s2[c][j]) : 0.0;
        out.d += counts ? 1.0 - s1[c][j] * factor[c][j] : 0.0;
      }
    }
    if (!has_gradient_) {
      return out;
    }
    VarianceGradient& gradient = out.gradient;
    gradient.position.resize(n_lights);
    gradient.axis.resize(n_lights);
    gradient.log_power.resize(n_lights * n_channels);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const Rays& r = rays[k];
      const NearLight& light = lights_[k];
      Lane q_sum = Lane::Zero();
      for (std::size_t c = 0; c < n_channels; ++c) {
        // Q = A S1 / (K S2) (S1 A / S2 - 1)
        const Lane q = r.a[c] * factor[c] * (s1[c] * r.a[c] * per_s2[c] - 1.0);
        gradient.log_power[k * n_channels + c] = -q.sum();
        q_sum += q;
      }
      // d ln A / d l = (3 + mu) w / r^2 - n / (n.w) + mu axis / off,  d ln A / d axis = mu w /
      // off
      const Lane by_r2 = (3.0 + light.mu) * q_sum * r.inverse_r2;
      const Lane by_facing = q_sum * r.inverse_facing;
      const Lane by_off = light.mu * q_sum * r.inverse_off;
      gradient.position[k] = Eigen::Vector3d((by_r2 * r.wx - by_facing * points.nx).sum(),
                                             (by_r2 * r.wy - by_facing * points.ny).sum(),
                                             (by_r2 * r.wz - by_facing * points.nz).sum()) +
                             by_off.sum() * light.axis;
      gradient.axis[k] = {(by_off * r.wx).sum(), (by_off * r.wy).sum(), (by_off * r.wz).sum()};
      gradient.mu -= (q_sum * r.log_cos).sum();
    }
    return out;
  }

  const TargetSamples& samples_;
  std::span<const NearLight> lights_;
  bool has_gradient_;
  std::atomic<bool> is_behind_ = false;
};

}  // namespace

VarianceValue normalised_variance(const TargetSamples& samples,
                                  std::span<const NearLight> lights, bool has_gradient) {
  HAARLIGHT_EXPECTS(lights.size() == static_cast<std::size_t>(samples.n_lights),
                    "a light for each picture");
  return Evaluation(samples, lights, has_gradient).run();
}

}  // namespace haarlight::relight
