// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/uniform_start.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include <Eigen/Cholesky>

#include "core/order_statistics.h"
#include "core/parallel.h"
#include "relight/calibration/light_terms.h"

namespace haarlight::relight {

namespace {

constexpr int kMaxSteps = 60;
constexpr std::ptrdiff_t kLeastSamples = 6;
constexpr double kSpread = 0.1;  // of ln albedo over a sheet, with a margin

struct Guess {
  NearLight light;
  double log_power = 0.0;
  double misfit = std::numeric_limits<double>::max();
};

class OneLight {
 public:
  OneLight(const TargetColumns& target, const TargetSamples& samples, int k, double ground)
      : target_(target),
        used_(samples.used(k)),
        n_(static_cast<Eigen::Index>(samples.n_points())),
        ground_(ground) {
    weight_ = Eigen::ArrayXd::Zero(n_);
    log_i_ = Eigen::ArrayXd::Zero(n_);
    for (Eigen::Index p = 0; p < n_; ++p) {
      double sum = 0.0;
      for (int c = 0; c < samples.n_channels; ++c) {
        sum += static_cast<double>(samples.values(k, c)[p]);
      }
      if (used_[p] != 0 && sum > 0.0) {
        weight_[p] = 1.0;
        log_i_[p] = std::log(sum);
      }
    }
  }

  /// Levenberg-Marquardt on (x, y, z over the height, ln power).
  [[nodiscard]] Guess fit(NearLight light) const {
    std::optional<Trial> now = look(light);
    if (!now) {
      return {light};
    }
    double damping = 1e-3;
    for (int i = 0; i < kMaxSteps && damping < 1e8; ++i) {
      Eigen::Matrix4d m = now->normal;
      m.diagonal() *= 1.0 + damping;
      m.diagonal().array() += 1e-9;
      const Eigen::Vector4d step = m.ldlt().solve(now->rhs);
      NearLight next = light;
      const double h = light.position_mm.z() - ground_;
      const auto bounded = [](double s) { return std::clamp(s, -0.5, 0.5); };
      next.position_mm.x() += h * bounded(step[0]);
      next.position_mm.y() += h * bounded(step[1]);
      next.position_mm.z() = ground_ + h * std::exp(bounded(step[2]));
      turn_to_aim(next);
      std::optional<Trial> trial = look(next);
      if (trial && trial->misfit < now->misfit) {
        const bool is_done = now->misfit - trial->misfit < 1e-10 * now->misfit;
        light = next;
        now = std::move(trial);
        damping = std::max(damping * 0.2, 1e-12);
        if (is_done) {
          break;
        }
      } else {
        damping *= 5.0;
      }
    }
    return {light, now->log_power, now->misfit};
  }

  /// Where the picture is brightest: the mean position, weighted by the fourth power.
  [[nodiscard]] Eigen::Vector3d bright_position() const {
    const Eigen::ArrayXd w = weight_ * (4.0 * (log_i_ - log_i_.maxCoeff())).exp();
    const double sum = std::max(w.sum(), 1e-300);
    return {(w * target_.point.col(0)).sum() / sum, (w * target_.point.col(1)).sum() / sum,
            ground_};
  }

 private:
  struct Trial {
    Eigen::Matrix4d normal;
    Eigen::Vector4d rhs;
    double log_power = 0.0;
    double misfit = 0.0;
  };
  /// The power is optimal for each position.
  [[nodiscard]] std::optional<Trial> look(const NearLight& light) const {
    const LightTerms t = light_terms(target_, light, used_);
    if (!t.reaches_used) {
      return std::nullopt;
    }
    const double h = light.position_mm.z() - ground_;
    const Eigen::ArrayXd log_h = t.h.max(1e-300).log();
    Trial out;
    std::vector<double> apart;
    for (Eigen::Index p = 0; p < n_; ++p) {
      if (weight_[p] > 0.0) {
        apart.push_back(log_i_[p] - log_h[p]);
      }
    }
    out.log_power = upper_median(apart);
    // Cauchy loss: a shadow over a third of the sheet does not bias the fit.
    const Eigen::ArrayXd miss = log_i_ - log_h - out.log_power;
    const Eigen::ArrayXd square = (miss / kSpread).square();
    const Eigen::ArrayXd weight = weight_ / (1.0 + square);
    Eigen::Matrix<double, Eigen::Dynamic, 4> j(n_, 4);
    j.leftCols<3>() = h * per_position(t, light);
    j.col(3).setOnes();
    const Eigen::Matrix<double, Eigen::Dynamic, 4> wj = j.array().colwise() * weight;
    out.normal = j.transpose() * wj;
    out.rhs = wj.transpose() * miss.matrix();
    out.misfit = (weight_ * (1.0 + square).log()).sum();
    return out;
  }

  const TargetColumns& target_;
  const std::uint8_t* used_;
  Eigen::Index n_;
  double ground_;
  Eigen::ArrayXd weight_;
  Eigen::ArrayXd log_i_;
};

}  // namespace

std::vector<NearLight> uniform_albedo_start(const TargetSamples& samples,
                                            std::vector<NearLight> start) {
  const TargetColumns target(samples);
  const TargetExtent extent = target_extent(samples);
  const double ground = target.point.col(2).maxCoeff();
  parallel_for(start.size(), 4, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint8_t* used = samples.used(static_cast<int>(k));
      if (std::count(used, used + samples.n_points(), 1) < kLeastSamples) {
        continue;
      }
      const OneLight one(target, samples, static_cast<int>(k), ground);
      Guess best = one.fit(start[k]);
      const Eigen::Vector3d bright = one.bright_position();
      for (const double height : {0.25, 1.0, 4.0}) {
        for (const double out : {1.0, 4.0}) {
          NearLight light = start[k];
          light.position_mm = extent.centre + out * (bright - extent.centre);
          light.position_mm.z() = ground + height * extent.size_mm;
          turn_to_aim(light);
          Guess guess = one.fit(light);
          if (guess.misfit < best.misfit) {
            best = guess;
          }
        }
      }
      if (best.misfit < std::numeric_limits<double>::max()) {
        start[k] = best.light;
        start[k].power = Eigen::Vector3d::Constant(std::exp(best.log_power));
      }
    }
  });
  double sum = 0.0;
  for (const NearLight& light : start) {
    sum += light.power[0] / static_cast<double>(start.size());
  }
  for (NearLight& light : start) {
    light.power /= sum;
  }
  return start;
}

}  // namespace haarlight::relight
