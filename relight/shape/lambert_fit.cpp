#include "relight/shape/lambert_fit.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include "core/error.h"

namespace haarlight {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kUnknowns = 3;
constexpr double kBrightRank = 0.9;
constexpr double kSigmaOfMedian = 1.4826;
constexpr double kSettled = 1e-4;     // change of b between rounds, relative: 0.006 degrees
constexpr double kLeastScale = 1e-6;  // of |b|: float samples of an exact Lambertian

constexpr int kHistogramFrom = 128;
constexpr int kBuckets = 512;  // 16 an octave: 32 octaves below the largest

/// Sixteenths of an octave, for values >= 0: the exponent and 4 bits of a float.
std::int32_t octave_part(double value) {
  return static_cast<std::int32_t>(std::bit_cast<std::uint32_t>(static_cast<float>(value)) >>
                                   19U);
}

double own_scales(RobustLoss loss) {
  switch (loss) {
    case RobustLoss::huber:
      return 0.1;
    case RobustLoss::cauchy:
      return 0.5;
    case RobustLoss::tukey:
      return 3.0;
  }
  return 0.0;
}

}  // namespace

std::string_view to_string(LambertMethod method) noexcept {
  switch (method) {
    case LambertMethod::least_squares:
      return "least-squares";
    case LambertMethod::trimmed:
      return "trimmed";
    case LambertMethod::m_estimator:
      return "m-estimator";
  }
  return "";
}

std::optional<Vector3d> unknown_direction(const std::vector<Vector3d>& directions) {
  Matrix3d sum = Matrix3d::Zero();
  for (const Vector3d& s : directions) {
    sum += s * s.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(sum);
  if (solver.eigenvalues()[0] >= kAmbiguous * solver.eigenvalues()[2] &&
      solver.eigenvalues()[2] > 0.0) {
    return std::nullopt;
  }
  return Vector3d(solver.eigenvectors().col(0));
}

LambertFitter::LambertFitter(int n_lights, const LambertOptions& options)
    : options_(options),
      x_(n_lights),
      y_(n_lights),
      z_(n_lights),
      value_(n_lights),
      w_(n_lights),
      r_(n_lights),
      light_(static_cast<std::size_t>(n_lights)) {
  HAARLIGHT_EXPECTS(options.keep > 0.0 && options.keep <= 1.0 && options.dark_share >= 0.0 &&
                        options.dark_share < 1.0 && options.loss_scales >= 0.0,
                    "shares within 0 to 1");
  sorted_.reserve(static_cast<std::size_t>(n_lights));
}

void LambertFitter::accumulate() {
  const auto x = x_.head(n_);
  const auto y = y_.head(n_);
  const auto z = z_.head(n_);
  const auto v = value_.head(n_);
  const auto w = w_.head(n_);
  const double xy = (w * x * y).sum();
  const double xz = (w * x * z).sum();
  const double yz = (w * y * z).sum();
  matrix_ << (w * x * x).sum(), xy, xz, xy, (w * y * y).sum(), yz, xz, yz, (w * z * z).sum();
  right_ = {(w * x * v).sum(), (w * y * v).sum(), (w * z * v).sum()};
}

bool LambertFitter::solve(Vector3d& b) const {
  Matrix3d inverse;
  bool is_invertible = false;
  matrix_.computeInverseWithCheck(inverse, is_invertible, 0.0);
  if (!is_invertible) {
    return false;
  }
  b = inverse * right_;
  return b.allFinite();
}

/// The value of that rank among the first n_. Large sets: a histogram over the logarithm first,
/// since selection by exchange mispredicts every other branch.
double LambertFitter::select(const Eigen::ArrayXd& values, int rank) {
  sorted_.clear();
  int within = rank;
  if (n_ < kHistogramFrom) {
    sorted_.assign(values.data(), values.data() + n_);
  } else {
    const double top = values.head(n_).maxCoeff();
    const std::int32_t last = octave_part(top);
    const auto bucket = [last](double value) {
      const std::int32_t below = last - octave_part(std::max(value, 0.0));
      return static_cast<std::size_t>(kBuckets - 1 - std::min(below, kBuckets - 1));
    };
    histogram_.assign(static_cast<std::size_t>(kBuckets), 0);
    for (int i = 0; i < n_; ++i) {
      ++histogram_[bucket(values[i])];
    }
    std::size_t chosen = 0;
    while (within >= histogram_[chosen]) {
      within -= histogram_[chosen];
      ++chosen;
    }
    for (int i = 0; i < n_; ++i) {
      if (bucket(values[i]) == chosen) {
        sorted_.push_back(values[i]);
      }
    }
  }
  const auto at = sorted_.begin() + within;
  std::nth_element(sorted_.begin(), at, sorted_.end());
  return *at;
}

/// Moves the samples that count to the front.
void LambertFitter::drop_dark() {
  double bright = select(value_, static_cast<int>(kBrightRank * (n_ - 1)));
  if (!(bright > 0.0)) {  // lit by less than a tenth of the lights
    bright = value_.head(n_).maxCoeff();
  }
  const double least = std::max(options_.dark_level, options_.dark_share * bright);
  int n = 0;
  for (int i = 0; i < n_; ++i) {
    if (value_[i] > least) {
      x_[n] = x_[i];
      y_[n] = y_[i];
      z_[n] = z_[i];
      value_[n] = value_[i];
      light_[static_cast<std::size_t>(n)] = light_[static_cast<std::size_t>(i)];
      ++n;
    }
  }
  n_ = n;
}

void LambertFitter::residuals(const Vector3d& b) {
  r_.head(n_) =
      (value_.head(n_) - b.x() * x_.head(n_) - b.y() * y_.head(n_) - b.z() * z_.head(n_)).abs();
}

/// Concentration steps: each cannot raise the sum of the kept squares. Samples that come or go
/// change the sums one by one.
void LambertFitter::trim(Vector3d& b) {
  const int n_keep =
      std::min(n_, std::max(2 * kUnknowns, static_cast<int>(std::ceil(options_.keep * n_))));
  if (n_keep == n_) {
    return;
  }
  for (int round = 0; round < options_.max_rounds; ++round) {
    residuals(b);
    const double most = select(r_, n_keep - 1);
    int n_changed = 0;
    for (int i = 0; i < n_; ++i) {
      const double weight = r_[i] <= most ? 1.0 : 0.0;
      if (weight == w_[i]) {
        continue;
      }
      const Vector3d s(x_[i], y_[i], z_[i]);
      matrix_ += (weight - w_[i]) * s * s.transpose();
      right_ += (weight - w_[i]) * value_[i] * s;
      w_[i] = weight;
      ++n_changed;
    }
    if (n_changed == 0) {
      break;
    }
    const Vector3d before = b;
    if (!solve(b)) {
      return;
    }
    if ((b - before).norm() <= kSettled * b.norm()) {
      break;
    }
  }
  accumulate();  // without the rounding of sums that came and went
  (void)solve(b);
}

void LambertFitter::reweight(Vector3d& b) {
  const double c =
      options_.loss_scales > 0.0 ? options_.loss_scales : own_scales(options_.loss);
  for (int round = 0; round < options_.max_rounds; ++round) {
    residuals(b);
    const double scale = std::max(kSigmaOfMedian * select(r_, n_ / 2), kLeastScale * b.norm());
    if (!(scale > 0.0)) {
      return;
    }
    for (int i = 0; i < n_; ++i) {
      const double u = r_[i] / scale;
      const double t = u / c;
      switch (options_.loss) {
        case RobustLoss::huber:
          w_[i] = t > 1.0 ? 1.0 / t : 1.0;
          break;
        case RobustLoss::cauchy:
          w_[i] = 1.0 / (1.0 + t * t);
          break;
        case RobustLoss::tukey:
          w_[i] = t < 1.0 ? (1.0 - t * t) * (1.0 - t * t) : 0.0;
          break;
      }
    }
    const Vector3d before = b;
    accumulate();
    if (!solve(b) || (b - before).norm() <= kSettled * b.norm()) {
      return;
    }
  }
}

LambertFit LambertFitter::fit() {
  LambertFit result;
  const int n_given = n_;
  if (n_ > 0) {
    drop_dark();
  }
  result.n_used = n_;
  if (n_ < kUnknowns) {
    result.state = n_given + n_clipped_ >= kUnknowns && n_ + n_clipped_ >= kUnknowns
                       ? PixelState::saturated
                       : PixelState::too_dark;
    return result;
  }
  w_.head(n_).setOnes();
  Vector3d b = Vector3d::Zero();
  accumulate();
  const bool is_solved = solve(b);
  if (is_solved && options_.method == LambertMethod::trimmed) {
    trim(b);
  } else if (is_solved && options_.method == LambertMethod::m_estimator) {
    reweight(b);
  }
  // The smallest eigenvalue is at least 4 det / trace^2: mostly that is enough to know.
  const double trace = matrix_.trace();
  if (!(4.0 * matrix_.determinant() >= kAmbiguous * trace * trace * trace)) {
    Eigen::SelfAdjointEigenSolver<Matrix3d> eigen(matrix_);
    if (!(eigen.eigenvalues()[0] >= kAmbiguous * eigen.eigenvalues()[2])) {
      result.state = PixelState::ambiguous;
      result.unknown = eigen.eigenvectors().col(0);
      return result;
    }
  }
  const double length = b.norm();
  if (!(length > 0.0) || !b.allFinite()) {
    return result;
  }
  residuals(b);
  const double sum = (w_.head(n_) * r_.head(n_).square()).sum();
  result.b = b;
  result.error = std::sqrt(sum / w_.head(n_).sum()) / length;
  result.n_used = static_cast<int>((w_.head(n_) > 0.0).count());
  result.state = PixelState::good;
  return result;
}

}  // namespace haarlight
