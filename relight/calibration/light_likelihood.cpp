// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/light_likelihood.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/calibration/light_terms.h"

namespace haarlight::relight {

namespace {

// A prior too weak to affect anything the samples determine, but which keeps every system
// solvable: each unknown is known to a factor e^(+-30).
constexpr double kWeakPrior = 1.0 / (30.0 * 30.0);
constexpr std::size_t kLightsAtOnce = 16;
constexpr Eigen::Index kTile = 128;
constexpr Eigen::Index kDensePoints = 600;
constexpr int kModeDegree = 11;

/// A light's own unknowns: 4, or 6 where its aim is not certain.
constexpr int kMostOwn = 6;
using OwnMatrix =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMostOwn, kMostOwn>;
using OwnVector = Eigen::Matrix<double, Eigen::Dynamic, 1, Eigen::ColMajor, kMostOwn, 1>;

/// The highest point: lights are above it, and steps scale their height over it by factors.
double ground_of(const TargetSamples& samples) {
  double z = -1e300;
  for (const Eigen::Vector3d& p : samples.points_mm) {
    z = std::max(z, p.z());
  }
  return z;
}

/// Normal equations. A light's unknowns: (x, y, z) in units of its height; where wanted its
/// aim, two numbers in units of their prior sigma; last, ln power. Common ones: ln albedo of
/// each point (unless known), then S shared by all lights.
struct Equations {
  std::vector<OwnMatrix> own;      ///< (K)
  std::vector<OwnVector> own_rhs;  ///< (K)
  Eigen::MatrixXd cross;           ///< (G, N K), N own unknowns
  Eigen::VectorXd common_point;    ///< (P or 0), diagonal
  Eigen::MatrixXd point_shared;    ///< (P or 0, S), points against the shared unknowns
  Eigen::MatrixXd shared;          ///< (S, S)
  Eigen::VectorXd rhs;             ///< (G)
  double chi2 = 0.0;
  bool is_valid = true;
};

class FreeSystem {
 public:
  /// @param known  exponent and distances at which the aims' prior holds
  FreeSystem(const TargetSamples& samples, const LikelihoodOptions& options,
             std::span<const NearLight> known, const TestModes* modes = nullptr)
      : samples_(samples),
        options_(options),
        shared_(options.is_mu_free, options.sheet, modes),
        target_(samples),
        n_points_(static_cast<Eigen::Index>(samples.n_points())),
        n_free_points_(options.is_albedo_known ? 0 : n_points_),
        n_common_(n_free_points_ + shared_.size()),
        n_own_(options.aim_sigma > 0.0 ? kMostOwn : 4),
        ground_(ground_of(samples)),
        middle_(target_extent(samples).centre) {
    for (const NearLight& light : known) {
      known_.push_back(std::max(light.mu, 0.01) / distance(light));
    }
  }

  [[nodiscard]] const SharedTerms& shared() const { return shared_; }
  [[nodiscard]] double height(const NearLight& light) const {
    return light.position_mm.z() - ground_;
  }

  /// Assembles everything at one parameter vector.
  [[nodiscard]] Equations assemble(std::span<const NearLight> lights,
                                   std::span<const double> albedo, const SheetValues& sheet,
                                   std::span<const float> inverse_variance) const {
    const std::size_t n_lights = lights.size();
    const Eigen::Index n_shared = shared_.size();
    const TargetColumns target(samples_, sheet);
    Equations eq;
    eq.own.assign(n_lights, OwnMatrix::Zero(n_own_, n_own_));
    eq.own_rhs.assign(n_lights, OwnVector::Zero(n_own_));
    eq.cross.setZero(n_common_, first_own(n_lights));
    const std::size_t n_chunks = (n_lights + kLightsAtOnce - 1) / kLightsAtOnce;
    struct Partial {
      Eigen::ArrayXd w, w_rho;
      Eigen::MatrixXd point_shared, shared;
      Eigen::VectorXd shared_rhs;
      double chi2 = 0.0;
      bool is_valid = true;
    };
    std::vector<Partial> partial(n_chunks);
    parallel_for(n_lights, kLightsAtOnce, [&](std::size_t begin, std::size_t end) {
      Partial& sum = partial[begin / kLightsAtOnce];
      sum.w = sum.w_rho = Eigen::ArrayXd::Zero(n_points_);
      sum.point_shared.setZero(n_free_points_, n_shared);
      sum.shared.setZero(n_shared, n_shared);
      sum.shared_rhs.setZero(n_shared);
      Eigen::MatrixXd j(n_points_, n_own_);
      Eigen::MatrixXd wj(n_points_, n_own_);
      Eigen::MatrixXd c(n_points_, n_shared);
      for (std::size_t k = begin; k < end; ++k) {
        const int light = static_cast<int>(k);
        LightTerms t =
            light_terms(target, lights[k], samples_.used(light), shared_.wanted(false));
        const LightResidual r =
            light_residual(samples_, light, t, lights[k].power, albedo, inverse_variance);
        sum.is_valid = sum.is_valid && t.reaches_used;
        j.leftCols<3>() = height(lights[k]) * per_position(t, lights[k]);
        j.col(n_own_ - 1).setOnes();
        if (has_aim()) {
          j.middleCols<2>(3).setZero();
        }
        if (has_aim() && lights[k].aim_mm) {
          const Eigen::MatrixXd per_off = t.axis.matrix() * axis_per_aim(lights[k]);
          j.middleCols<2>(3) = aim_unit(k, lights[k]) * per_off;
          // Position and exponent alone, with mu aim_off / distance held.
          const Eigen::VectorXd by_off =
              per_off * (across_aim(lights[k]).transpose() * lights[k].aim_off);
          t.log_cos -= by_off.array() / lights[k].mu;
          j.leftCols<3>() += height(lights[k]) / std::pow(distance(lights[k]), 2) * by_off *
                             (lights[k].position_mm - middle_).transpose();
        }
        wj = j.array().colwise() * r.w;
        eq.own[k] = j.transpose() * wj;
        eq.own_rhs[k] = j.transpose() * r.w_rho.matrix();
        sum.chi2 += add_aim_prior(k, lights[k], eq.own[k], eq.own_rhs[k]);
        const Eigen::Index column = first_own(k);
        if (n_free_points_ > 0) {
          eq.cross.block(0, column, n_points_, n_own_) = wj;
          sum.w += r.w;
          sum.w_rho += r.w_rho;
        }
        if (n_shared > 0) {
          shared_.fill(target, t, light, c);
          if (has_aim() && shared_.n_test() > 0) {
            c.rightCols<1>() = angles_to_aim(target, lights[k]).square().matrix();
          }
          eq.cross.block(n_free_points_, column, n_shared, n_own_) = c.transpose() * wj;
          sum.shared_rhs += c.transpose() * r.w_rho.matrix();
          const Eigen::MatrixXd wc = c.array().colwise() * r.w;
          sum.shared.noalias() += c.transpose() * wc;
          if (n_free_points_ > 0) {
            sum.point_shared += wc;
          }
        }
        sum.chi2 += r.chi2;
      }
    });
    eq.rhs.setZero(n_common_);
    eq.common_point.setZero(n_free_points_);
    eq.point_shared.setZero(n_free_points_, n_shared);
    eq.shared.setZero(n_shared, n_shared);
    for (const Partial& sum : partial) {
      if (n_free_points_ > 0) {
        eq.common_point += sum.w.matrix();
        eq.rhs.head(n_points_) += sum.w_rho.matrix();
      }
      eq.point_shared += sum.point_shared;
      eq.shared += sum.shared;
      eq.rhs.tail(n_shared) += sum.shared_rhs;
      eq.chi2 += sum.chi2;
      eq.is_valid = eq.is_valid && sum.is_valid;
    }
    eq.chi2 += shared_.add_priors(sheet, eq.shared, eq.rhs.tail(n_shared));
    return eq;
  }

  /// The equations with damping, reduced to the common unknowns: S = direct - F F^T.
  struct Factored {
    std::vector<Eigen::LLT<OwnMatrix>> own;
    Eigen::MatrixXd reduced_cross;  ///< F, (G, N K): each light's columns times L^-T
    Eigen::VectorXd point;          ///< damped diagonal
    Eigen::MatrixXd point_shared;   ///< (P, S)
    Eigen::MatrixXd shared;         ///< (S, S), damped
    double gauge = 0.0;             ///< times the all-ones matrix of the points
    bool is_dense = true;
    Cholesky common;           ///< of S; with modes, of V^T S V
    Eigen::VectorXd diagonal;  ///< (G), D
    Eigen::MatrixXd modes;     ///< (G, M), V with V^T D V = 1
    [[nodiscard]] bool is_sound() const { return common.is_positive_definite(); }
  };
  [[nodiscard]] Factored factor(const Equations& eq, double damping) const {
    Factored f;
    f.own.resize(eq.own.size());
    f.reduced_cross = eq.cross;
    parallel_for(eq.own.size(), kLightsAtOnce, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        OwnMatrix own = eq.own[k];
        own.diagonal() *= 1.0 + damping;
        own.diagonal().array() += kWeakPrior;
        f.own[k].compute(own);
        auto columns = f.reduced_cross.middleCols(first_own(k), n_own_);
        f.own[k].matrixU().solveInPlace<Eigen::OnTheRight>(columns);
      }
    });
    if (n_free_points_ > 0) {
      f.point = ((1.0 + damping) * eq.common_point.array() + kWeakPrior).matrix();
      // The common scale of power and albedo: the mean of ln albedo is held.
      f.gauge = std::max(eq.common_point.mean(), 1.0) / static_cast<double>(n_points_);
      f.point_shared = eq.point_shared;
    }
    f.shared = eq.shared;
    f.shared.diagonal() *= 1.0 + damping;
    f.shared.diagonal().array() += kWeakPrior;
    f.is_dense = options_.coupling == Coupling::dense || n_free_points_ == 0 ||
                 (options_.coupling == Coupling::automatic && n_common_ <= kDensePoints);
    if (f.is_dense) {
      factor_dense(f);
    } else {
      factor_modes(f);
    }
    return f;
  }

  struct Step {
    Eigen::VectorXd common;      ///< (G)
    std::vector<OwnVector> own;  ///< (K)
    double predicted = 0.0;      ///< predicted decrease of chi^2, by the linear model
  };
  /// What a step without damping would lower chi^2 by. Even a little damping stops the steps
  /// along a weak direction, such as power against distance, far from its minimum.
  [[nodiscard]] double decrement(const Equations& eq) const {
    const Factored undamped = factor(eq, 0.0);
    return undamped.is_sound() ? solve(eq, undamped).predicted
                               : std::numeric_limits<double>::infinity();
  }
  [[nodiscard]] Step solve(const Equations& eq, const Factored& f) const {
    const std::size_t n_lights = eq.own.size();
    Eigen::VectorXd rhs = eq.rhs;
    Eigen::VectorXd reduced(first_own(n_lights));
    for (std::size_t k = 0; k < n_lights; ++k) {
      reduced.segment(first_own(k), n_own_) = f.own[k].matrixL().solve(eq.own_rhs[k]);
    }
    Step step;
    if (n_common_ > 0) {
      rhs.noalias() -= f.reduced_cross * reduced;
      step.common = f.is_dense ? f.common.solve(rhs) : descend(f, rhs);
      reduced.noalias() -= f.reduced_cross.transpose() * step.common;
    }
    step.own.resize(n_lights);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const OwnVector part = reduced.segment(first_own(k), n_own_);
      step.own[k] = f.own[k].matrixU().solve(part);
      step.predicted += step.own[k].dot(eq.own_rhs[k]);
    }
    step.predicted += step.common.size() > 0 ? step.common.dot(eq.rhs) : 0.0;
    return step;
  }

  /// Moves a copy of lights and albedo. Factors keep heights, powers and albedos positive.
  void take(const Step& step, std::vector<NearLight>& lights, std::vector<double>& albedo,
            SheetValues& sheet) const {
    const double limit = 1.0;  // a factor e per step
    const auto bounded = [limit](double x) { return std::clamp(x, -limit, limit); };
    for (std::size_t k = 0; k < lights.size(); ++k) {
      NearLight& light = lights[k];
      const double h = height(light);
      const double before = distance(light);
      const OwnVector& own = step.own[k];
      if (has_aim()) {
        light.aim_off +=
            across_aim(light) *
            (aim_unit(k, light) * Eigen::Vector2d(bounded(own[3]), bounded(own[4])));
      }
      light.position_mm.x() += h * bounded(own[0]);
      light.position_mm.y() += h * bounded(own[1]);
      light.position_mm.z() = ground_ + h * std::exp(bounded(own[2]));
      if (has_aim()) {
        light.aim_off *= distance(light) / before;
      }
      turn_to_aim(light);
      light.power *= std::exp(bounded(own[n_own_ - 1]));
    }
    for (Eigen::Index p = 0; p < n_free_points_; ++p) {
      const double factor = std::exp(bounded(step.common[p]));
      for (int c = 0; c < samples_.n_channels; ++c) {
        albedo[static_cast<std::size_t>(c * n_points_ + p)] *= factor;
      }
    }
    if (shared_.size() > 0) {
      double mu = lights.front().mu;
      shared_.take(step.common.tail(shared_.size()), mu, sheet);
      for (NearLight& light : lights) {
        const double before = light.mu;
        light.mu = options_.is_mu_free ? mu : light.mu;
        if (has_aim() && light.mu > 0.0) {
          light.aim_off *= before / light.mu;
          turn_to_aim(light);
        }
      }
    }
  }

  /// The test modes' own equations, all else eliminated: the trailing block of the factored
  /// system's lower triangle.
  [[nodiscard]] ModelTest test(const Equations& eq, const Factored& f, double freedom) const {
    const Eigen::Index n = shared_.n_test();
    if (!f.is_sound() || n == 0) {
      return {};
    }
    Eigen::VectorXd rhs = eq.rhs;
    for (std::size_t k = 0; k < eq.own.size(); ++k) {
      const OwnVector part = f.own[k].matrixL().solve(eq.own_rhs[k]);
      rhs.noalias() -= f.reduced_cross.middleCols(first_own(k), n_own_) * part;
    }
    Eigen::VectorXd direct = f.shared.diagonal().tail(n);
    if (!f.is_dense) {
      rhs = f.modes.transpose() * rhs;
      // There the shared unknowns are scaled by the square root of their own weight.
      direct.setOnes();
    }
    const Eigen::VectorXd half = f.common.solve_lower(rhs);
    const Eigen::MatrixXd corner = f.common.corner(n);
    return score_modes(corner * corner.transpose(), corner * half.tail(n), direct, eq.chi2,
                       freedom);
  }

  /// Covariances from a factored system: of light i, L^-T (1 + F_i^T S^-1 F_i) L^-1.
  [[nodiscard]] LightBounds bounds(std::span<const NearLight> lights, const Factored& f) const {
    const std::size_t n_lights = lights.size();
    LightBounds out;
    out.lights.resize(n_lights);
    double total_power = 0.0;
    for (const NearLight& light : lights) {
      total_power += light.power[0];
    }
    const auto fraction = [&](std::size_t k) { return lights[k].power[0] / total_power; };
    const auto last = [&](std::size_t k) {
      return f.own[k].matrixLLT()(n_own_ - 1, n_own_ - 1);
    };
    // The mean of ln power, whose error each light's relative power also has.
    Eigen::VectorXd mean = Eigen::VectorXd::Zero(n_common_);
    double mean_own = 0.0;
    for (std::size_t k = 0; k < n_lights; ++k) {
      mean += fraction(k) / last(k) * f.reduced_cross.col(first_own(k + 1) - 1);
      mean_own += std::pow(fraction(k) / last(k), 2);
    }
    const Eigen::VectorXd mean_solved = inverse_times(f, mean);
    const double mean_variance = mean_own + mean.dot(mean_solved);
    const std::size_t at_once = 4 * kLightsAtOnce;
    parallel_for(n_lights, at_once, [&](std::size_t begin, std::size_t end) {
      const Eigen::Index first = first_own(begin);
      const auto y = f.reduced_cross.middleCols(first, first_own(end) - first);
      const Eigen::MatrixXd solved = inverse_times(f, y);
      for (std::size_t k = begin; k < end; ++k) {
        const Eigen::Index at = first_own(k) - first;
        OwnMatrix inner = OwnMatrix::Identity(n_own_, n_own_);
        inner.noalias() += y.middleCols(at, n_own_).transpose() * solved.middleCols(at, n_own_);
        const OwnMatrix half = f.own[k].matrixU().solve(inner);  // L^-T inner
        const OwnMatrix covariance = f.own[k].matrixU().solve(half.transpose());
        const double h = height(lights[k]);
        out.lights[k].position_mm2 = h * h * covariance.topLeftCorner<3, 3>();
        double variance = covariance(n_own_ - 1, n_own_ - 1);
        if (n_free_points_ > 0) {
          const double with_mean = fraction(k) / (last(k) * last(k)) +
                                   y.col(at + n_own_ - 1).dot(mean_solved) / last(k);
          variance += mean_variance - 2.0 * with_mean;
        }
        out.lights[k].power = std::sqrt(std::max(variance, 0.0));
      }
    });
    const Eigen::Index n_shared = shared_.size();
    if (n_shared > 0) {
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(n_common_, n_shared);
      unit.bottomRows(n_shared).setIdentity();
      const Eigen::MatrixXd covariance = inverse_times(f, unit).bottomRows(n_shared);
      out.mu = options_.is_mu_free ? std::sqrt(covariance(0, 0)) : 0.0;
      out.sheet = shared_.sigmas(covariance);
    }
    return out;
  }

 private:
  [[nodiscard]] bool has_aim() const { return n_own_ == kMostOwn; }
  /// Index of light k's first unknown.
  [[nodiscard]] Eigen::Index first_own(std::size_t k) const {
    return n_own_ * static_cast<Eigen::Index>(k);
  }
  [[nodiscard]] double distance(const NearLight& light) const {
    return (light.position_mm - middle_).norm();
  }
  /// aim_off of one unit of its unknown. The prior is on mu aim_off / distance, which is what
  /// the pictures show: on aim_off alone it would favour large mu and near lights, and bias
  /// both.
  [[nodiscard]] double aim_unit(std::size_t k, const NearLight& light) const {
    return options_.aim_sigma * known_[k] * distance(light) / std::max(light.mu, 1e-3);
  }
  /// The prior on a light's aim. @return  its chi^2
  [[nodiscard]] double add_aim_prior(std::size_t k, const NearLight& light, OwnMatrix& matrix,
                                     OwnVector& rhs) const {
    if (!has_aim()) {
      return 0.0;
    }
    const Eigen::Vector2d off =
        across_aim(light).transpose() * light.aim_off / aim_unit(k, light);
    matrix.diagonal().segment<2>(3).array() += 1.0;
    rhs.segment<2>(3) -= off;
    return off.squaredNorm();
  }
  /// Angles between the directions to the aim and to the points, rad.
  [[nodiscard]] static Eigen::ArrayXd angles_to_aim(const TargetColumns& target,
                                                    const NearLight& light) {
    const Eigen::Vector3d way =
        light.aim_mm ? Eigen::Vector3d((*light.aim_mm - light.position_mm).normalized())
                     : light.axis;
    Eigen::ArrayX3d to = target.point;
    to.rowwise() -= light.position_mm.transpose().array();
    const Eigen::ArrayXd along = (to.matrix() * way).array();
    return (along / to.square().rowwise().sum().sqrt()).min(1.0).max(-1.0).acos();
  }

  void factor_dense(Factored& f) const {
    Eigen::MatrixXd s = Eigen::MatrixXd::Zero(n_common_, n_common_);
    if (n_free_points_ > 0) {
      s.topLeftCorner(n_points_, n_points_).setConstant(f.gauge);
      s.diagonal().head(n_points_) += f.point;
      s.bottomLeftCorner(shared_.size(), n_points_) = f.point_shared.transpose();
    }
    s.bottomRightCorner(shared_.size(), shared_.size()) = f.shared;
    const auto n_tiles = static_cast<std::size_t>((n_common_ + kTile - 1) / kTile);
    parallel_for(n_tiles, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t tile = begin; tile < end; ++tile) {
        const Eigen::Index j0 = static_cast<Eigen::Index>(tile) * kTile;
        const Eigen::Index width = std::min(kTile, n_common_ - j0);
        s.block(j0, j0, n_common_ - j0, width).noalias() -=
            f.reduced_cross.bottomRows(n_common_ - j0) *
            f.reduced_cross.middleRows(j0, width).transpose();
      }
    });
    f.common = Cholesky(s);  // reads the lower triangle
  }

  /// S without the lights' part, times columns.
  [[nodiscard]] Eigen::MatrixXd direct_times(const Factored& f,
                                             const Eigen::MatrixXd& x) const {
    Eigen::MatrixXd y(x.rows(), x.cols());
    const auto points = x.topRows(n_points_);
    y.topRows(n_points_) = points.array().colwise() * f.point.array();
    y.topRows(n_points_).rowwise() += f.gauge * points.colwise().sum();
    const auto shared = x.bottomRows(shared_.size());
    y.topRows(n_points_).noalias() += f.point_shared * shared;
    y.bottomRows(shared_.size()).noalias() =
        f.point_shared.transpose() * points + f.shared * shared;
    return y;
  }

  /// Polynomials on the target, orthonormal with respect to D, with their own small system.
  void factor_modes(Factored& f) const {
    f.diagonal.resize(n_common_);
    f.diagonal.head(n_points_) = f.point;
    f.diagonal.tail(shared_.size()) = f.shared.diagonal();
    const Eigen::ArrayXd half = f.diagonal.array().sqrt();
    int degree = kModeDegree;
    while (degree > 0 && Eigen::Index{degree + 1} * (degree + 2) > n_points_) {
      --degree;  // at most half as many modes as points
    }
    const Eigen::Index n_modes = (degree + 1) * (degree + 2) / 2;
    Eigen::MatrixXd v = Eigen::MatrixXd::Zero(n_common_, n_modes + shared_.size());
    const auto scaled = [](const Eigen::ArrayXd& x) -> Eigen::ArrayXd {
      const double middle = 0.5 * (x.minCoeff() + x.maxCoeff());
      return (x - middle) / std::max(x.maxCoeff() - middle, 1e-300);
    };
    const Eigen::ArrayXXd tx = chebyshev(scaled(target_.point.col(0)));
    const Eigen::ArrayXXd ty = chebyshev(scaled(target_.point.col(1)));
    Eigen::Index column = 0;
    for (int i = 0; i <= degree; ++i) {
      for (int j = 0; i + j <= degree; ++j) {
        v.col(column++).head(n_points_) =
            (tx.col(i) * ty.col(j) * half.head(n_points_)).matrix();
      }
    }
    for (Eigen::Index i = 0; i < shared_.size(); ++i) {
      v(n_points_ + i, column + i) = half[n_points_ + i];
    }
    f.modes = orthonormal_columns(v).array().colwise() / half;
    const Eigen::MatrixXd lights = f.modes.transpose() * f.reduced_cross;
    Eigen::MatrixXd s = f.modes.transpose() * direct_times(f, f.modes);
    s.noalias() -= lights * lights.transpose();
    f.common = Cholesky(s);
  }

  [[nodiscard]] static Eigen::ArrayXXd chebyshev(const Eigen::ArrayXd& x) {
    Eigen::ArrayXXd t(x.size(), kModeDegree + 1);
    t.col(0).setOnes();
    t.col(1) = x;
    for (int i = 2; i <= kModeDegree; ++i) {
      t.col(i) = 2.0 * x * t.col(i - 1) - t.col(i - 2);
    }
    return t;
  }

  /// S^-1 times columns: exact if dense, by the modes otherwise.
  [[nodiscard]] Eigen::MatrixXd inverse_times(const Factored& f,
                                              const Eigen::MatrixXd& x) const {
    if (n_common_ == 0) {
      return x;
    }
    if (f.is_dense) {
      return f.common.solve(x);
    }
    const Eigen::MatrixXd inner = f.modes.transpose() * x;
    const Eigen::MatrixXd corrected = f.common.solve(inner) - inner;
    Eigen::MatrixXd y = x.array().colwise() / f.diagonal.array();
    y.noalias() += f.modes * corrected;
    return y;
  }

  /// Preconditioned conjugate gradients to 1e-8 of the right-hand side.
  [[nodiscard]] Eigen::VectorXd descend(const Factored& f, const Eigen::VectorXd& rhs) const {
    constexpr int kMostSteps = 200;
    constexpr double kSmall = 1e-8;
    Eigen::VectorXd x = inverse_times(f, rhs);
    const auto times = [&](const Eigen::VectorXd& v) -> Eigen::VectorXd {
      const Eigen::VectorXd through = f.reduced_cross.transpose() * v;
      Eigen::VectorXd y = direct_times(f, v);
      y.noalias() -= f.reduced_cross * through;
      return y;
    };
    Eigen::VectorXd r = rhs - times(x);
    Eigen::VectorXd z = inverse_times(f, r);
    Eigen::VectorXd p = z;
    double rz = r.dot(z);
    const double enough = kSmall * kSmall * std::max(rhs.dot(x), 1e-300);
    for (int i = 0; i < kMostSteps && rz > enough; ++i) {
      const Eigen::VectorXd sp = times(p);
      const double alpha = rz / p.dot(sp);
      x += alpha * p;
      r -= alpha * sp;
      z = inverse_times(f, r);
      const double next = r.dot(z);
      p = z + (next / rz) * p;
      rz = next;
    }
    return x;
  }

  const TargetSamples& samples_;
  const LikelihoodOptions& options_;
  SharedTerms shared_;
  TargetColumns target_;
  Eigen::Index n_points_;
  Eigen::Index n_free_points_;
  Eigen::Index n_common_;
  Eigen::Index n_own_;
  double ground_;
  Eigen::Vector3d middle_;
  std::vector<double> known_;  ///< (K), mu / distance
};

std::int64_t count_used(const TargetSamples& samples) {
  return std::accumulate(samples.is_used.begin(), samples.is_used.end(), std::int64_t{0}) *
         samples.n_channels;
}

}  // namespace

LightBounds free_light_bounds(const TargetSamples& samples, std::span<const NearLight> lights,
                              std::span<const double> albedo,
                              const LikelihoodOptions& options) {
  const FreeSystem system(samples, options, lights);
  const SheetValues& sheet = options.sheet_start;
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, sheet), lights, albedo);
  const Equations eq = system.assemble(lights, albedo, sheet, weights);
  return system.bounds(lights, system.factor(eq, 0.0));
}

ModelTest test_free_lights(const TargetSamples& samples, const LikelihoodFit& fit,
                           const LikelihoodOptions& options, double freedom) {
  const TestModes modes = test_modes(samples, fit.lights);
  const FreeSystem system(samples, options, fit.lights, &modes);
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, fit.sheet), fit.lights, fit.albedo);
  const Equations eq = system.assemble(fit.lights, fit.albedo, fit.sheet, weights);
  return system.test(eq, system.factor(eq, 0.0), freedom);
}

LikelihoodFit fit_free_lights(const TargetSamples& samples, std::vector<NearLight> lights,
                              const LikelihoodOptions& options) {
  HAARLIGHT_EXPECTS(!options.is_albedo_known, "albedo is fitted");
  constexpr double kLeastDamping = 1e-13;
  constexpr double kMostDamping = 1e6;
  constexpr double kCreeping = 0.05;
  const FreeSystem system(samples, options, lights);
  LikelihoodFit fit;
  fit.sheet = options.sheet_start;
  PowerFit start = fit_powers(samples, std::move(lights), 8, {}, fit.sheet);
  fit.lights = std::move(start.lights);
  fit.albedo = std::move(start.albedo);
  const std::vector<float> weights =
      inverse_variances(samples, TargetColumns(samples, fit.sheet), fit.lights, fit.albedo);
  Equations eq = system.assemble(fit.lights, fit.albedo, fit.sheet, weights);
  if (!eq.is_valid) {
    throw Error("a light starts behind a part of the target that it lights",
                "near-light calibration", "start above the target, or mask that part");
  }
  double damping = 0.0;
  double good_damping = 1e-6;  // of the last step that helped
  bool was_refused = false;
  while (fit.n_iterations < options.max_iterations && damping < kMostDamping) {
    if (options.should_stop && options.should_stop()) {
      break;
    }
    ++fit.n_iterations;
    const FreeSystem::Factored factored = system.factor(eq, damping);
    const FreeSystem::Step step = system.solve(eq, factored);
    if (factored.is_sound() && step.predicted < options.tolerance_chi2 &&
        (damping == 0.0 || step.predicted < kCreeping * options.tolerance_chi2 ||
         system.decrement(eq) < options.tolerance_chi2)) {
      fit.has_converged = true;
      // The last step still helps and costs nothing more.
      system.take(step, fit.lights, fit.albedo, fit.sheet);
      break;
    }
    std::vector<NearLight> next_lights = fit.lights;
    std::vector<double> next_albedo = fit.albedo;
    SheetValues next_sheet = fit.sheet;
    bool is_better = factored.is_sound();
    Equations next;
    if (is_better) {
      system.take(step, next_lights, next_albedo, next_sheet);
      if (samples.n_channels > 1) {
        PowerFit powers = fit_powers(samples, std::move(next_lights), 2, weights, next_sheet);
        next_lights = std::move(powers.lights);
        next_albedo = std::move(powers.albedo);
      }
      next = system.assemble(next_lights, next_albedo, next_sheet, weights);
      is_better = next.is_valid && next.chi2 < eq.chi2;
    }
    if (is_better) {
      fit.lights = std::move(next_lights);
      fit.albedo = std::move(next_albedo);
      fit.sheet = next_sheet;
      const double gain = (eq.chi2 - next.chi2) / step.predicted;
      eq = std::move(next);
      good_damping = damping > 0.0 ? damping : good_damping;
      // In a curved valley less damping was just rejected: once is enough.
      damping = gain > 0.5 && !was_refused ? damping / 10.0 : damping;
      damping = damping < kLeastDamping ? 0.0 : damping;
      was_refused = false;
    } else {
      damping = damping > 0.0 ? 10.0 * damping : good_damping;
      was_refused = true;
    }
  }
  fit.chi2 = eq.chi2;
  fit.n_samples = count_used(samples);
  fix_power_scale(samples, fit.lights, fit.albedo);
  return fit;
}

PowerFit fit_powers(const TargetSamples& samples, std::vector<NearLight> lights, int n_sweeps,
                    std::span<const float> inverse_variance, const SheetValues& sheet) {
  const TargetColumns target(samples, sheet);
  const auto n = static_cast<Eigen::Index>(samples.n_points());
  const auto n_lights = static_cast<Eigen::Index>(lights.size());
  PowerFit fit;
  fit.albedo.assign(static_cast<std::size_t>(n * samples.n_channels), 0.0);
  Eigen::ArrayXXd h(n, n_lights);
  Eigen::ArrayXXd used(n, n_lights);
  parallel_for(lights.size(), kLightsAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t k = begin; k < end; ++k) {
      const std::uint8_t* u = samples.used(static_cast<int>(k));
      h.col(static_cast<Eigen::Index>(k)) = light_terms(target, lights[k], u).h;
      used.col(static_cast<Eigen::Index>(k)) =
          Eigen::Map<const Eigen::Array<std::uint8_t, Eigen::Dynamic, 1>>(u, n).cast<double>();
    }
  });
  for (int c = 0; c < samples.n_channels; ++c) {
    Eigen::ArrayXXd intensity(n, n_lights);
    for (Eigen::Index k = 0; k < n_lights; ++k) {
      intensity.col(k) =
          Eigen::Map<const Eigen::ArrayXf>(samples.values(static_cast<int>(k), c), n)
              .cast<double>();
    }
    // The noise from the sample itself: the same for both sides of the alternation.
    Eigen::ArrayXXd weight = used / intensity.unaryExpr([&](double value) {
      return std::max(samples.noise.variance(std::max(value, 0.0)), 1e-300);
    });
    if (!inverse_variance.empty()) {
      for (Eigen::Index k = 0; k < n_lights; ++k) {
        const auto at = static_cast<std::size_t>((k * samples.n_channels + c) * n);
        weight.col(k) =
            Eigen::Map<const Eigen::ArrayXf>(inverse_variance.data() + at, n).cast<double>();
      }
    }
    Eigen::ArrayXd e(n_lights);
    for (Eigen::Index k = 0; k < n_lights; ++k) {
      e[k] = lights[static_cast<std::size_t>(k)].power[c];
    }
    Eigen::ArrayXd a = Eigen::ArrayXd::Zero(n);
    const Eigen::ArrayXXd wih = weight * intensity * h;
    const Eigen::ArrayXXd whh = weight * h.square();
    for (int sweep = 0; sweep < n_sweeps; ++sweep) {
      const Eigen::ArrayXd above = (wih.matrix() * e.matrix()).array();
      const Eigen::ArrayXd below = (whh.matrix() * e.square().matrix()).array();
      a = (below > 0.0).select(above / below.max(1e-300), 0.0);
      const Eigen::ArrayXd e_above = (wih.matrix().transpose() * a.matrix()).array();
      const Eigen::ArrayXd e_below = (whh.matrix().transpose() * a.square().matrix()).array();
      e = (e_below > 0.0 && e_above > 0.0).select(e_above / e_below.max(1e-300), e);
    }
    for (Eigen::Index p = 0; p < n; ++p) {
      fit.albedo[static_cast<std::size_t>(c * n + p)] = std::max(a[p], 0.0);
    }
    for (Eigen::Index k = 0; k < n_lights; ++k) {
      lights[static_cast<std::size_t>(k)].power[c] = e[k];
    }
  }
  fit.lights = std::move(lights);
  fix_power_scale(samples, fit.lights, fit.albedo);
  return fit;
}

}  // namespace haarlight::relight
