// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/rigid_likelihood.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include <Eigen/Geometry>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/calibration/light_terms.h"

namespace haarlight::relight {

namespace {

constexpr double kWeakPrior = 1.0 / (30.0 * 30.0);  // as light_likelihood.cpp
constexpr std::size_t kLightsAtOnce = 16;
constexpr Eigen::Index kTile = 64;

constexpr Eigen::Index kPose = 6;  // turn, shift over the height; then the shared unknowns

Eigen::Vector3d middle_of(std::span<const NearLight> lights) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const NearLight& light : lights) {
    sum += light.position_mm;
  }
  return sum / static_cast<double>(lights.size());
}

struct Equations {
  Eigen::MatrixXd pose;        ///< (Q, Q): the pose, then the shared unknowns
  Eigen::VectorXd pose_rhs;    ///< (Q)
  Eigen::MatrixXd light_pose;  ///< (K, Q)
  Eigen::VectorXd light;       ///< (K), diagonal
  Eigen::VectorXd light_rhs;
  Eigen::MatrixXd point_pose;  ///< (P, Q)
  Eigen::VectorXd point;       ///< (P), diagonal
  Eigen::VectorXd point_rhs;
  Eigen::MatrixXd weight;  ///< (P, K)
  double chi2 = 0.0;
  bool is_valid = true;
};

class RigidSystem {
 public:
  RigidSystem(const TargetSamples& samples, const LikelihoodOptions& options, double unit_mm,
              const TestModes* modes = nullptr)
      : samples_(samples),
        options_(options),
        shared_(options.is_mu_free, options.sheet, modes),
        unit_mm_(unit_mm) {}

  [[nodiscard]] const SharedTerms& shared() const { return shared_; }
  /// Unknowns other than the lights' powers and the points.
  [[nodiscard]] Eigen::Index n_common() const { return kPose + shared_.size(); }

  [[nodiscard]] Equations assemble(std::span<const NearLight> lights,
                                   std::span<const double> albedo, const SheetValues& sheet,
                                   std::span<const float> inverse_variance) const {
    const TargetColumns target(samples_, sheet);
    const Eigen::Index n_common = this->n_common();
    const auto n = static_cast<Eigen::Index>(samples_.n_points());
    const auto n_lights = static_cast<Eigen::Index>(lights.size());
    const Eigen::Vector3d middle = middle_of(lights);
    Equations eq;
    eq.pose.setZero(n_common, n_common);
    eq.pose_rhs.setZero(n_common);
    eq.light_pose.setZero(n_lights, n_common);
    eq.light.setZero(n_lights);
    eq.light_rhs.setZero(n_lights);
    eq.point_pose.setZero(n, n_common);
    eq.point.setZero(n);
    eq.point_rhs.setZero(n);
    eq.weight.setZero(n, n_lights);
    struct Partial {
      Eigen::MatrixXd pose;
      Eigen::VectorXd pose_rhs;
      Eigen::MatrixXd point_pose;
      Eigen::VectorXd point_rhs;
      double chi2 = 0.0;
      bool is_valid = true;
    };
    std::vector<Partial> partial((lights.size() + kLightsAtOnce - 1) / kLightsAtOnce);
    parallel_for(lights.size(), kLightsAtOnce, [&](std::size_t begin, std::size_t end) {
      Partial& sum = partial[begin / kLightsAtOnce];
      sum.pose.setZero(n_common, n_common);
      sum.pose_rhs.setZero(n_common);
      sum.point_pose.setZero(n, n_common);
      sum.point_rhs.setZero(n);
      Eigen::MatrixXd j(n, n_common);
      for (std::size_t k = begin; k < end; ++k) {
        const auto i = static_cast<Eigen::Index>(k);
        const int light = static_cast<int>(k);
        const LightTerms t =
            light_terms(target, lights[k], samples_.used(light), shared_.wanted(true));
        const LightResidual r =
            light_residual(samples_, light, t, lights[k].power, albedo, inverse_variance);
        sum.is_valid = sum.is_valid && t.reaches_used;
        const Eigen::Vector3d v = lights[k].position_mm - middle;
        const Eigen::Vector3d& a = lights[k].axis;
        // d ln h = turn . (v x g_l + axis x g_axis) + shift . g_l
        for (int c = 0; c < 3; ++c) {
          const int c1 = (c + 1) % 3;
          const int c2 = (c + 2) % 3;
          j.col(c) = (v[c1] * t.position.col(c2) - v[c2] * t.position.col(c1) +
                      a[c1] * t.axis.col(c2) - a[c2] * t.axis.col(c1))
                         .matrix();
          j.col(3 + c) = unit_mm_ * t.position.col(c).matrix();
        }
        shared_.fill(target, t, light, j.rightCols(shared_.size()));
        const Eigen::MatrixXd wj = j.array().colwise() * r.w;
        sum.pose += j.transpose() * wj;
        sum.pose_rhs += j.transpose() * r.w_rho.matrix();
        sum.point_pose += wj;
        sum.point_rhs += r.w_rho.matrix();
        sum.chi2 += r.chi2;
        eq.light_pose.row(i) = wj.colwise().sum();
        eq.light[i] = r.w.sum();
        eq.light_rhs[i] = r.w_rho.sum();
        eq.weight.col(i) = r.w.matrix();
      }
    });
    for (const Partial& sum : partial) {
      eq.pose += sum.pose;
      eq.pose_rhs += sum.pose_rhs;
      eq.point_pose += sum.point_pose;
      eq.point_rhs += sum.point_rhs;
      eq.chi2 += sum.chi2;
      eq.is_valid = eq.is_valid && sum.is_valid;
    }
    eq.point = eq.weight.rowwise().sum();
    eq.chi2 +=
        shared_.add_priors(sheet, eq.pose.bottomRightCorner(shared_.size(), shared_.size()),
                           eq.pose_rhs.tail(shared_.size()));
    return eq;
  }

  /// Lights, then the pose: points eliminated.
  struct Reduced {
    Eigen::MatrixXd matrix;  ///< (K + Q, K + Q), lower triangle
    Eigen::VectorXd rhs;
    Eigen::VectorXd inverse_point;  ///< (P); empty where the albedo is known
  };
  [[nodiscard]] Reduced reduce(const Equations& eq, double damping) const {
    const Eigen::Index n_lights = eq.light.size();
    const Eigen::Index n_common = this->n_common();
    Reduced out;
    out.matrix.setZero(n_lights + n_common, n_lights + n_common);
    out.rhs.resize(n_lights + n_common);
    auto lights = out.matrix.topLeftCorner(n_lights, n_lights);
    if (!options_.is_albedo_known) {
      // The common scale of power and albedo: the mean of ln power is held.
      lights.setConstant(std::max(eq.light.mean(), 1.0) / static_cast<double>(n_lights));
    }
    lights.diagonal() += ((1.0 + damping) * eq.light.array() + kWeakPrior).matrix();
    out.matrix.bottomLeftCorner(n_common, n_lights) = eq.light_pose.transpose();
    Eigen::MatrixXd pose = eq.pose;
    pose.diagonal() *= 1.0 + damping;
    pose.diagonal().array() += kWeakPrior;
    out.matrix.bottomRightCorner(n_common, n_common) = pose;
    out.rhs.head(n_lights) = eq.light_rhs;
    out.rhs.tail(n_common) = eq.pose_rhs;
    if (options_.is_albedo_known) {
      return out;
    }
    out.inverse_point = ((1.0 + damping) * eq.point.array() + kWeakPrior).inverse();
    const Eigen::MatrixXd scaled =
        eq.weight.array().colwise() * out.inverse_point.array().sqrt();
    const Eigen::MatrixXd scaled_pose =
        eq.point_pose.array().colwise() * out.inverse_point.array().sqrt();
    const Eigen::VectorXd scaled_rhs = eq.point_rhs.array() * out.inverse_point.array().sqrt();
    parallel_for(static_cast<std::size_t>((n_lights + kTile - 1) / kTile), 1,
                 [&](std::size_t begin, std::size_t end) {
                   for (std::size_t tile = begin; tile < end; ++tile) {
                     const Eigen::Index j0 = static_cast<Eigen::Index>(tile) * kTile;
                     const Eigen::Index width = std::min(kTile, n_lights - j0);
                     out.matrix.block(j0, j0, n_lights - j0, width).noalias() -=
                         scaled.rightCols(n_lights - j0).transpose() *
                         scaled.middleCols(j0, width);
                   }
                 });
    out.matrix.bottomLeftCorner(n_common, n_lights).noalias() -=
        scaled_pose.transpose() * scaled;
    out.matrix.bottomRightCorner(n_common, n_common).noalias() -=
        scaled_pose.transpose() * scaled_pose;
    out.rhs.head(n_lights).noalias() -= scaled.transpose() * scaled_rhs;
    out.rhs.tail(n_common).noalias() -= scaled_pose.transpose() * scaled_rhs;
    return out;
  }

  struct Step {
    Eigen::VectorXd light;   ///< (K), of ln power
    Eigen::VectorXd common;  ///< (Q), of the pose and the shared terms
    Eigen::VectorXd point;   ///< (P), of ln albedo
    double predicted = 0.0;  ///< predicted decrease of chi^2, by the linear model
  };
  /// @return  nothing where the equations are not positive definite
  [[nodiscard]] std::optional<Step> solve(const Equations& eq, double damping) const {
    const Reduced reduced = reduce(eq, damping);
    const Cholesky factored(reduced.matrix);
    if (!factored.is_positive_definite()) {
      return std::nullopt;
    }
    const Eigen::VectorXd both = factored.solve(reduced.rhs);
    Step step;
    step.light = both.head(eq.light.size());
    step.common = both.tail(n_common());
    step.point = (eq.point_rhs - eq.weight * step.light - eq.point_pose * step.common)
                     .cwiseProduct(reduced.inverse_point);
    step.predicted = step.light.dot(eq.light_rhs) + step.common.dot(eq.pose_rhs) +
                     step.point.dot(eq.point_rhs);
    return step;
  }

  [[nodiscard]] double unit_mm() const { return unit_mm_; }

 private:
  const TargetSamples& samples_;
  const LikelihoodOptions& options_;
  SharedTerms shared_;
  double unit_mm_;
};

double mean_height(const TargetSamples& samples, std::span<const NearLight> lights) {
  return std::max(std::abs(middle_of(lights).z() - target_extent(samples).centre.z()), 1e-9);
}

/// Lights with the powers and exponents of others.
std::vector<NearLight> with_powers(std::vector<NearLight> lights,
                                   std::span<const NearLight> powers) {
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].power = powers[k].power;
    lights[k].mu = powers[k].mu;
  }
  return lights;
}

}  // namespace

std::vector<NearLight> array_at(const RigidArray& array,
                                const Eigen::Isometry3d& world_from_array, double mu) {
  HAARLIGHT_EXPECTS(
      array.positions_mm.size() == array.axes.size() &&
          (array.emitters_mm.empty() || array.emitters_mm.size() == array.positions_mm.size()),
      "an axis, and an emitter where there is one, for each position");
  std::vector<NearLight> lights(array.positions_mm.size());
  for (std::size_t k = 0; k < lights.size(); ++k) {
    lights[k].position_mm = world_from_array * array.positions_mm[k];
    lights[k].axis = world_from_array.linear() * array.axes[k];
    lights[k].mu = mu;
    if (!array.emitters_mm.empty()) {
      lights[k].emitter_mm = world_from_array.linear() * array.emitters_mm[k];
    }
  }
  return lights;
}

PoseBound rigid_bound(const TargetSamples& samples, std::span<const NearLight> lights,
                      std::span<const double> albedo, const LikelihoodOptions& options) {
  const RigidSystem system(samples, options, mean_height(samples, lights));
  const SheetValues& sheet = options.sheet_start;
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, sheet), lights, albedo);
  const RigidSystem::Reduced reduced =
      system.reduce(system.assemble(lights, albedo, sheet, weights), 0.0);
  const Eigen::Index n = reduced.matrix.rows();
  const Eigen::MatrixXd inverse =
      Cholesky(reduced.matrix).solve(Eigen::MatrixXd(Eigen::MatrixXd::Identity(n, n)));
  const Eigen::Index n_common = system.n_common();
  const Eigen::Index n_shared = n_common - kPose;
  Eigen::VectorXd unit = Eigen::VectorXd::Ones(n_common);
  unit.segment<3>(3).setConstant(system.unit_mm());
  const Eigen::MatrixXd pose =
      unit.asDiagonal() * inverse.bottomRightCorner(n_common, n_common) * unit.asDiagonal();
  PoseBound bound;
  bound.covariance = pose.topLeftCorner<6, 6>();
  bound.mu = options.is_mu_free ? std::sqrt(pose(kPose, kPose)) : 0.0;
  bound.sheet = system.shared().sigmas(pose.bottomRightCorner(n_shared, n_shared));
  // Powers relative to their mean.
  Eigen::VectorXd fraction(static_cast<Eigen::Index>(lights.size()));
  for (Eigen::Index k = 0; k < fraction.size(); ++k) {
    fraction[k] = lights[static_cast<std::size_t>(k)].power[0];
  }
  fraction /= fraction.sum();
  const auto powers = inverse.topLeftCorner(fraction.size(), fraction.size());
  const Eigen::VectorXd with_mean = powers * fraction;
  const double mean = options.is_albedo_known ? 0.0 : fraction.dot(with_mean);
  const Eigen::Vector3d middle = middle_of(lights);
  bound.lights.resize(lights.size());
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    const Eigen::Vector3d v = lights[k].position_mm - middle;
    Eigen::Matrix<double, 3, 6> move;
    move << 0, v.z(), -v.y(), 1, 0, 0,  //
        -v.z(), 0, v.x(), 0, 1, 0,      //
        v.y(), -v.x(), 0, 0, 0, 1;
    bound.lights[k].position_mm2 = move * bound.covariance * move.transpose();
    const double variance =
        powers(i, i) - (options.is_albedo_known ? 0.0 : 2.0 * with_mean[i] - mean);
    bound.lights[k].power = std::sqrt(std::max(variance, 0.0));
  }
  return bound;
}

ModelTest test_rigid_array(const TargetSamples& samples, const LikelihoodFit& fit,
                           const LikelihoodOptions& options, double freedom) {
  const TestModes modes = test_modes(samples, fit.lights);
  const RigidSystem system(samples, options, mean_height(samples, fit.lights), &modes);
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, fit.sheet), fit.lights, fit.albedo);
  const Equations eq = system.assemble(fit.lights, fit.albedo, fit.sheet, weights);
  const RigidSystem::Reduced reduced = system.reduce(eq, 0.0);
  const Cholesky factored(reduced.matrix);
  if (!factored.is_positive_definite()) {
    return {};
  }
  // The modes are the last unknowns: their own equations are the corner of the factor.
  const Eigen::Index n = modes.size();
  const Eigen::VectorXd half = factored.solve_lower(reduced.rhs);
  const Eigen::MatrixXd corner = factored.corner(n);
  return score_modes(corner * corner.transpose(), corner * half.tail(n),
                     eq.pose.diagonal().tail(n), eq.chi2, freedom);
}

namespace {

/// What a step of the fit changes.
struct RigidState {
  Eigen::Isometry3d world_from_array;
  double mu = 0.0;
  std::vector<NearLight> lights;
  std::vector<double> albedo;
  SheetValues sheet;
};

/// At most 0.3 radians, 0.3 heights and a factor e of each power and albedo from `at`.
RigidState stepped(const RigidState& at, const RigidSystem::Step& step,
                   const TargetSamples& samples, const RigidArray& array,
                   const RigidSystem& system, const std::vector<float>& weights,
                   const LikelihoodOptions& options) {
  RigidState next{at.world_from_array, at.mu, {}, at.albedo, at.sheet};
  const Eigen::Vector3d middle = middle_of(at.lights);
  const Eigen::Vector3d turn = step.common.head<3>();
  const double angle = std::min(turn.norm(), 0.3);
  const Eigen::Vector3d shift = system.unit_mm() * step.common.segment<3>(3);
  const double longest = 0.3 * system.unit_mm();
  Eigen::Isometry3d move = Eigen::Isometry3d::Identity();
  move.translate(shift * std::min(1.0, longest / std::max(shift.norm(), 1e-300)) + middle);
  if (angle > 0.0) {
    move.rotate(Eigen::AngleAxisd(angle, turn.normalized()));
  }
  move.translate(-middle);
  next.world_from_array = move * at.world_from_array;
  system.shared().take(step.common.tail(system.shared().size()), next.mu, next.sheet);
  next.lights = with_powers(array_at(array, next.world_from_array, next.mu), at.lights);
  if (options.is_mu_free) {
    for (NearLight& light : next.lights) {
      light.mu = next.mu;
    }
  }
  for (std::size_t k = 0; k < next.lights.size(); ++k) {
    next.lights[k].power *=
        std::exp(std::clamp(step.light[static_cast<Eigen::Index>(k)], -1.0, 1.0));
  }
  const auto n_points = static_cast<std::size_t>(step.point.size());
  for (std::size_t i = 0; i < next.albedo.size(); ++i) {
    next.albedo[i] *=
        std::exp(std::clamp(step.point[static_cast<Eigen::Index>(i % n_points)], -1.0, 1.0));
  }
  if (samples.n_channels > 1) {
    PowerFit powers = fit_powers(samples, std::move(next.lights), 2, weights, next.sheet);
    next.lights = std::move(powers.lights);
    next.albedo = std::move(powers.albedo);
  }
  return next;
}

}  // namespace

RigidFit fit_rigid_array(const TargetSamples& samples, const RigidArray& array,
                         const Eigen::Isometry3d& start, std::vector<NearLight> lights,
                         const LikelihoodOptions& options) {
  HAARLIGHT_EXPECTS(!options.is_albedo_known, "albedo is fitted");
  constexpr double kMostDamping = 1e6;
  constexpr double kCreeping = 0.05;
  RigidState now{start, lights.front().mu, {}, {}, options.sheet_start};
  PowerFit first = fit_powers(samples, with_powers(array_at(array, start, now.mu), lights), 8,
                              {}, now.sheet);
  now.lights = std::move(first.lights);
  now.albedo = std::move(first.albedo);
  const RigidSystem system(samples, options, mean_height(samples, now.lights));
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, now.sheet), now.lights, now.albedo);
  Equations eq = system.assemble(now.lights, now.albedo, now.sheet, weights);
  if (!eq.is_valid) {
    throw Error("a light of the array starts behind a part of the target that it lights",
                "near-light calibration", "correct the array's pose in the rig file");
  }
  RigidFit out;
  LikelihoodFit& fit = out.fit;
  double damping = 0.0;
  while (fit.n_iterations < options.max_iterations && damping < kMostDamping) {
    if (options.should_stop && options.should_stop()) {
      break;
    }
    ++fit.n_iterations;
    const std::optional<RigidSystem::Step> step = system.solve(eq, damping);
    bool is_better = step.has_value();
    std::optional<RigidState> next;
    if (is_better) {
      next = stepped(now, *step, samples, array, system, weights, options);
    }
    const auto is_small = [&](const std::optional<RigidSystem::Step>& any) {
      return any.has_value() && any->predicted < options.tolerance_chi2;
    };
    // Even a little damping stops the steps along a weak direction far from its minimum.
    const bool is_last =
        is_small(step) &&
        (damping == 0.0 || step->predicted < kCreeping * options.tolerance_chi2 ||
         is_small(system.solve(eq, 0.0)));
    Equations next_eq;
    if (is_better && !is_last) {
      next_eq = system.assemble(next->lights, next->albedo, next->sheet, weights);
      is_better = next_eq.is_valid && next_eq.chi2 < eq.chi2;
    }
    if (is_better) {
      now = std::move(*next);
      if (is_last) {
        fit.has_converged = true;
        break;
      }
      const double gain = (eq.chi2 - next_eq.chi2) / step->predicted;
      eq = std::move(next_eq);
      damping = gain > 0.5 ? damping / 10.0 : damping;
      damping = damping < 1e-9 ? 0.0 : damping;
    } else {
      damping = std::max(10.0 * damping, 1e-6);
    }
  }
  out.world_from_array = now.world_from_array;
  fit.lights = std::move(now.lights);
  fit.albedo = std::move(now.albedo);
  fit.sheet = now.sheet;
  fit.chi2 = eq.chi2;
  fit.n_samples =
      std::accumulate(samples.is_used.begin(), samples.is_used.end(), std::int64_t{0}) *
      samples.n_channels;
  fix_power_scale(samples, fit.lights, fit.albedo);
  // Re-orthonormalised: stays a rotation through many products.
  out.world_from_array.linear() =
      Eigen::Quaterniond(out.world_from_array.linear()).normalized().toRotationMatrix();
  return out;
}

}  // namespace haarlight::relight
