// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/calibrate_with_shape.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <fmt/format.h>

#include "core/linear_algebra.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

// Smallest over largest eigenvalue of the lights' directions: below it, noise in one component
// of the normal would be amplified a thousandfold.
constexpr double kInPlane = 1e-6;

constexpr int kRemembered = 8;

/// Points in units of a length, and normals, as one long column.
Eigen::VectorXd state_of(std::span<const Eigen::Vector3d> points,
                         std::span<const Eigen::Vector3d> normals, double length) {
  const auto n = static_cast<Eigen::Index>(points.size());
  Eigen::VectorXd x(6 * n);
  for (Eigen::Index p = 0; p < n; ++p) {
    x.segment<3>(6 * p) = points[static_cast<std::size_t>(p)] / length;
    x.segment<3>(6 * p + 3) = normals[static_cast<std::size_t>(p)];
  }
  return x;
}

/// Anderson mixing: the combination of past rounds with the smallest residual. A round alone
/// reduces the slow modes by only a few per cent, since the lights adapt to a wrong shape.
class Mixing {
 public:
  /// @param x  a state  @param g  the result of a round from it  @return  the next state
  Eigen::VectorXd next(const Eigen::VectorXd& x, const Eigen::VectorXd& g) {
    const Eigen::VectorXd f = g - x;
    if (last_f_.size() > 0) {
      d_f_.emplace_back(f - last_f_);
      d_g_.emplace_back(g - last_g_);
      if (d_f_.size() > kRemembered) {
        d_f_.erase(d_f_.begin());
        d_g_.erase(d_g_.begin());
      }
    }
    last_f_ = f;
    last_g_ = g;
    if (d_f_.empty()) {
      return g;
    }
    const auto m = static_cast<Eigen::Index>(d_f_.size());
    Eigen::MatrixXd normal(m, m);
    Eigen::VectorXd rhs(m);
    for (Eigen::Index i = 0; i < m; ++i) {
      const Eigen::VectorXd& a = d_f_[static_cast<std::size_t>(i)];
      rhs[i] = a.dot(f);
      for (Eigen::Index j = 0; j < m; ++j) {
        normal(i, j) = a.dot(d_f_[static_cast<std::size_t>(j)]);
      }
    }
    normal.diagonal().array() *= 1.0 + 1e-10;
    const Eigen::VectorXd fraction = solve_symmetric(normal, rhs);
    Eigen::VectorXd out = g;
    for (Eigen::Index i = 0; i < m; ++i) {
      out -= fraction[i] * d_g_[static_cast<std::size_t>(i)];
    }
    return out;
  }
  void forget() {
    d_f_.clear();
    d_g_.clear();
    last_f_.resize(0);
  }

 private:
  std::vector<Eigen::VectorXd> d_f_;
  std::vector<Eigen::VectorXd> d_g_;
  Eigen::VectorXd last_f_;
  Eigen::VectorXd last_g_;
};

}  // namespace

PointNormals solve_normals(const TargetSamples& samples, std::span<const NearLight> lights) {
  const std::size_t n = samples.n_points();
  PointNormals out;
  out.normals = samples.normals;
  out.albedo.assign(n, 0.0);
  std::vector<Eigen::Vector3d> unknown(n, Eigen::Vector3d::Zero());
  parallel_for(n, 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t p = begin; p < end; ++p) {
      Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
      Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
      double weights = 0.0;
      for (std::size_t k = 0; k < lights.size(); ++k) {
        const NearLight& light = lights[k];
        const Eigen::Vector3d w = light.position_mm - samples.points_mm[p];
        const double r2 = w.squaredNorm();
        const Eigen::Vector3d way = w / std::sqrt(r2);
        const double off = -light.axis.dot(way);
        if (samples.used(static_cast<int>(k))[p] == 0 || !(off > 0.0)) {
          continue;
        }
        // I = a (n.way) e cos^mu / r^2; the noise of I gives each equation's weight.
        const double gain = light.power[0] * std::pow(off, light.mu) / r2;
        const auto value = static_cast<double>(samples.values(static_cast<int>(k))[p]);
        const double weight = 1.0 / std::max(samples.noise.variance(value), 1e-300);
        m += weight * gain * gain * way * way.transpose();
        rhs += weight * gain * value * way;
        weights += 1.0;
      }
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(m);
      if (weights < 3.0 || !(eigen.eigenvalues()[0] > kInPlane * eigen.eigenvalues()[2])) {
        unknown[p] = eigen.eigenvectors().col(0);
        continue;
      }
      const Eigen::Vector3d b = eigen.eigenvectors() *
                                eigen.eigenvalues().cwiseInverse().asDiagonal() *
                                eigen.eigenvectors().transpose() * rhs;
      out.albedo[p] = b.norm();
      out.normals[p] = b.normalized();
    }
  });
  for (std::size_t p = 0; p < n; ++p) {
    out.n_unsolved += out.albedo[p] > 0.0 ? 0 : 1;
  }
  if (out.n_unsolved == n) {
    const Eigen::Vector3d& d = unknown[n / 2];
    throw Error(fmt::format("no normal can be solved: the lights' directions lie in one plane, "
                            "or fewer than 3 reach each point; nothing is known along "
                            "({:.2f}, {:.2f}, {:.2f})",
                            d.x(), d.y(), d.z()),
                "photometric stereo", "light the object from a third side");
  }
  return out;
}

Alternation calibrate_with_shape(TargetSamples samples, std::vector<NearLight> start,
                                 const SurfaceFromNormals& surface,
                                 const AlternationOptions& options) {
  Alternation out;
  const double length = target_extent(samples).size_mm;
  Mixing mixing;
  double least = std::numeric_limits<double>::max();
  for (int round = 0; round < options.max_rounds; ++round) {
    CalibrationOptions lights = options.lights;
    if (round > 0) {
      lights.start = Start::given;
      lights.mu_start = std::max(out.lights.mu, 0.01);
    }
    out.lights = calibrate_free_lights(samples, start, lights);
    out.chi2.push_back(out.lights.reduced_chi2);
    for (std::size_t k = 0; k < start.size(); ++k) {
      start[k] = out.lights.lights[k].light;
    }
    TargetSamples next = samples;
    next.normals = solve_normals(samples, start).normals;
    next.points_mm = surface(next, next.normals);
    HAARLIGHT_EXPECTS(next.points_mm.size() == samples.n_points(), "a position for each point");
    double sum = 0.0;
    for (std::size_t p = 0; p < samples.n_points(); ++p) {
      sum += (next.points_mm[p] - samples.points_mm[p]).squaredNorm();
    }
    out.moves_mm.push_back(std::sqrt(sum / static_cast<double>(samples.n_points())));
    if (out.moves_mm.back() < options.tolerance_mm) {
      samples = std::move(next);
      out.has_converged = true;
      break;
    }
    // A mixture that fits much worse than the best round overshot.
    if (out.chi2.back() > 2.0 * least) {
      mixing.forget();
    }
    least = std::min(least, out.chi2.back());
    const Eigen::VectorXd mixed =
        mixing.next(state_of(samples.points_mm, samples.normals, length),
                    state_of(next.points_mm, next.normals, length));
    for (std::size_t p = 0; p < samples.n_points(); ++p) {
      const auto at = static_cast<Eigen::Index>(6 * p);
      samples.points_mm[p] = length * mixed.segment<3>(at);
      samples.normals[p] = mixed.segment<3>(at + 3).normalized();
    }
  }
  out.points_mm = std::move(samples.points_mm);
  out.normals = std::move(samples.normals);
  return out;
}

}  // namespace haarlight::relight
