// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/lambert_fit.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include "core/order_statistics.h"
#include "haarlight/core/error.h"
#include "relight/shape/sample_kernels.h"

namespace haarlight::relight {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kUnknowns = 3;
constexpr double kBrightRank = 0.9;
constexpr double kSettled = 1e-4;  // change of b between rounds, relative: 0.006 degrees
constexpr double kRightAngle = 0.5 * std::numbers::pi;
constexpr double kDegrees = 180.0 / std::numbers::pi;
/// Determinant over trace^3 of the matrix without a group; below it only two components are
/// determined (three equal eigenvalues: 1/27; 1 : 0.1 : kAmbiguous : 8e-6).
constexpr double kLeastRest = 1e-6;
/// Fraction of the angle between a robust fit and plain least squares that counts as its
/// standard error: what it rejects is the model's failure, some of which remains in what it
/// keeps.
constexpr double kDoubt = 0.5;
/// The part of the neighbours' common residual that is absorbed by b unnoticed: three of about
/// nine smooth functions of the light's direction (harmonics up to order 2) are b's, sqrt(3 /
/// 6).
constexpr double kShared = 0.7;
constexpr double kLeastScale = 1e-6;  // of |b|: float samples of an exact Lambertian

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
      ranked_(n_lights),
      product_(n_lights),
      kept_(static_cast<std::size_t>(n_lights)),
      is_changed_(static_cast<std::size_t>(n_lights) + sizeof(std::uint64_t)),
      changed_(static_cast<std::size_t>(n_lights)),
      light_(static_cast<std::size_t>(n_lights)) {
  HAARLIGHT_EXPECTS(options.keep > 0.0 && options.keep <= 1.0 && options.dark_fraction >= 0.0 &&
                        options.dark_fraction < 1.0 && options.loss_scales >= 0.0,
                    "fractions within 0 to 1");
}

void LambertFitter::add(std::span<const double> x, std::span<const double> y,
                        std::span<const double> z, std::span<const double> value,
                        std::span<const std::uint8_t> is_left_out) {
  const std::size_t n = x.size();
  double* const to_x = x_.data();
  double* const to_y = y_.data();
  double* const to_z = z_.data();
  double* const to_value = value_.data();
  int* const to_light = light_.data();
  // Every sample is written, and the next one over it if it is left out: no branch to guess.
  int next = n_;
  for (std::size_t j = 0; j < n; ++j) {
    to_x[next] = x[j];
    to_y[next] = y[j];
    to_z[next] = z[j];
    to_value[next] = value[j];
    to_light[next] = static_cast<int>(j);
    next += is_left_out[j] == 0 ? 1 : 0;
  }
  n_ = next;
}

SampleColumns LambertFitter::columns(int first, int n) const {
  return {x_.data() + first, y_.data() + first,     z_.data() + first,
          w_.data() + first, value_.data() + first, n};
}

LambertFitter::Sums LambertFitter::sums(int first, int n) const {
  const SampleSums found = weighted_sums(columns(first, n));
  Sums sums;
  sums.matrix << found.xx, found.xy, found.xz, found.xy, found.yy, found.yz, found.xz, found.yz,
      found.zz;
  sums.right = {found.xv, found.yv, found.zv};
  return sums;
}

void LambertFitter::accumulate() {
  const Sums all = sums(0, n_);
  matrix_ = all.matrix;
  right_ = all.right;
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

/// By interpolation between limits that are too low and too high: counting vectorises,
/// exchanges and histograms do not.
float LambertFitter::find_limit(int n_wanted, float guess, float reach) const {
  float low = 0.0F;
  float high = std::numeric_limits<float>::max();
  int n_low = 0;
  int n_high = n_;
  const auto take = [&](float limit) {
    const int n = count_within(ranked_.data(), n_, limit);
    const bool is_low = n < n_wanted;
    (is_low ? low : high) = limit;
    (is_low ? n_low : n_high) = n;
  };
  if (reach < guess) {
    take(guess - reach);
    take(guess + reach);
  } else {
    take(0.0F);
  }
  if (n_high == n_) {
    high = std::min(high, ranked_.head(n_).maxCoeff());
  }
  for (int step = 1; n_high > n_wanted; ++step) {
    // Every third step bisects, whatever the distribution.
    const float fraction = step % 3 == 0 ? 0.5F
                                         : (static_cast<float>(n_wanted - n_low) - 0.5F) /
                                               static_cast<float>(n_high - n_low);
    const float middle = low + fraction * (high - low);
    if (!(middle > low && middle < high)) {
      break;  // equal values
    }
    take(middle);
  }
  return high;
}

float LambertFitter::select(int rank) const {
  return largest_within(ranked_.data(), n_, find_limit(rank + 1));
}

/// Moves the samples that count to the front.
void LambertFitter::drop_dark() {
  to_floats(value_.data(), n_, ranked_.data());
  auto bright = double{select(static_cast<int>(kBrightRank * (n_ - 1)))};
  if (!(bright > 0.0)) {  // lit by less than a tenth of the lights
    bright = value_.head(n_).maxCoeff();
  }
  const double least = std::max(options_.dark_level, options_.dark_fraction * bright);
  double* const x = x_.data();
  double* const y = y_.data();
  double* const z = z_.data();
  double* const value = value_.data();
  int* const light = light_.data();
  int n = 0;
  while (n < n_ && value[n] > least) {
    ++n;
  }
  for (int i = n; i < n_; ++i) {
    const double v = value[i];
    x[n] = x[i];
    y[n] = y[i];
    z[n] = z[i];
    value[n] = v;
    light[n] = light[i];
    n += v > least ? 1 : 0;
  }
  n_ = n;
}

void LambertFitter::residuals(const Vector3d& b) {
  find_residuals(columns(0, n_), b, r_.data(), ranked_.data());
}

/// Concentration steps: none can raise the sum of the kept squares. Samples that enter or leave
/// update the sums one by one.
void LambertFitter::trim(Vector3d& b) {
  const int n_keep =
      std::min(n_, std::max(2 * kUnknowns, static_cast<int>(std::ceil(options_.keep * n_))));
  if (n_keep == n_) {
    return;
  }
  kept_.assign(static_cast<std::size_t>(n_), 1);
  float most = 0.0F;
  float reach = std::numeric_limits<float>::max();
  for (int round = 0; round < options_.max_rounds; ++round) {
    residuals(b);
    most = find_limit(n_keep, most, reach);
    const int n_changed = update_kept(most);
    if (n_changed == 0) {
      break;
    }
    add_changed(n_changed);
    const Vector3d before = b;
    if (!solve(b)) {
      return;
    }
    const double moved = (b - before).norm();
    if (moved <= kSettled * b.norm()) {
      break;
    }
    reach = static_cast<float>(moved);  // of each residual, and so of the limit
  }
  w_.head(n_) =
      Eigen::Map<const Eigen::Array<std::uint8_t, Eigen::Dynamic, 1>>(kept_.data(), n_)
          .cast<double>();
  accumulate();  // without the rounding of incremental updates
  (void)solve(b);
}

/// Updates the sums for samples that entered or left.
void LambertFitter::add_changed(int n_changed) {
  double xx = 0.0, xy = 0.0, xz = 0.0, yy = 0.0, yz = 0.0, zz = 0.0;
  double xv = 0.0, yv = 0.0, zv = 0.0;
  for (int j = 0; j < n_changed; ++j) {
    const int i = changed_[static_cast<std::size_t>(j)];
    const double sign = kept_[static_cast<std::size_t>(i)] != 0 ? 1.0 : -1.0;
    const double x = sign * x_[i];
    const double y = sign * y_[i];
    const double z = sign * z_[i];
    xx += x * x_[i];
    xy += x * y_[i];
    xz += x * z_[i];
    yy += y * y_[i];
    yz += y * z_[i];
    zz += z * z_[i];
    xv += x * value_[i];
    yv += y * value_[i];
    zv += z * value_[i];
  }
  Matrix3d change;
  change << xx, xy, xz, xy, yy, yz, xz, yz, zz;
  matrix_ += change;
  right_ += Vector3d(xv, yv, zv);
}

/// @return  how many samples entered or left; changed_ begins with their indices
int LambertFitter::update_kept(float most) {
  keep_within(ranked_.data(), n_, most, kept_.data(), is_changed_.data());
  constexpr int kAtOnce = sizeof(std::uint64_t);
  std::memset(is_changed_.data() + n_, 0, sizeof(std::uint64_t));
  int n = 0;
  for (int i = 0; i < n_; i += kAtOnce) {
    std::uint64_t any = 0;
    std::memcpy(&any, is_changed_.data() + i, sizeof(any));
    for (int j = i; any != 0 && j < std::min(i + kAtOnce, n_); ++j) {
      changed_[static_cast<std::size_t>(n)] = j;
      n += is_changed_[static_cast<std::size_t>(j)];
    }
  }
  return n;
}

void LambertFitter::reweight(Vector3d& b) {
  const double c =
      options_.loss_scales > 0.0 ? options_.loss_scales : own_scales(options_.loss);
  for (int round = 0; round < options_.max_rounds; ++round) {
    residuals(b);
    const double scale =
        std::max(kSigmaPerMad * double{select(n_ / 2)}, kLeastScale * b.norm());
    if (!(scale > 0.0)) {
      return;
    }
    switch (options_.loss) {
      case RobustLoss::huber:
        huber_weights(r_.data(), n_, scale, c, w_.data());
        break;
      case RobustLoss::cauchy:
        cauchy_weights(r_.data(), n_, scale, c, w_.data());
        break;
      case RobustLoss::tukey:
        tukey_weights(r_.data(), n_, scale, c, w_.data());
        break;
    }
    const Vector3d before = b;
    accumulate();
    if (!solve(b) || (b - before).norm() <= kSettled * b.norm()) {
      return;
    }
  }
}

double LambertFitter::median_residual(const LambertFit& fit) {
  HAARLIGHT_EXPECTS(fit.state == PixelState::good, "a good fit");
  residuals(fit.b);
  return double{select(n_ / 2)} / fit.b.norm();
}

int LambertFitter::group_of(int i) const {
  const int light = light_[static_cast<std::size_t>(i)];
  return group_.empty() ? light : group_[static_cast<std::size_t>(light)];
}

int LambertFitter::end_of_group(int first) const {
  int last = first + 1;
  while (last < n_ && group_of(last) == group_of(first)) {
    ++last;
  }
  return last;
}

/// Of the groups' G mean residuals the fit has absorbed three: (sum n_g m_g^2 / (G - 3) - s^2)
/// G / n, with s^2 what independent errors leave in each.
/// @param matrix  becomes sum s s^T of the lit samples
double LambertFitter::common_square(const Vector3d& b, Matrix3d& matrix) {
  find_products(columns(0, n_), b, product_.data());
  double xx = 0.0, xy = 0.0, xz = 0.0, yy = 0.0, yz = 0.0, zz = 0.0;
  double square = 0.0;
  double of_means = 0.0;
  int n_groups = 0;
  for (int first = 0; first < n_; ++n_groups) {
    const int last = end_of_group(first);
    double mean = 0.0;
    for (int i = first; i < last; ++i) {
      const double x = x_[i];
      const double y = y_[i];
      const double z = z_[i];
      const double r = value_[i] - product_[i];
      xx += x * x;
      xy += x * y;
      xz += x * z;
      yy += y * y;
      yz += y * z;
      zz += z * z;
      square += r * r;
      mean += r;
    }
    of_means += mean * mean / (last - first);
    first = last;
  }
  matrix << xx, xy, xz, xy, yy, yz, xz, yz, zz;
  const double within = std::max(0.0, square - of_means) / std::max(1, n_ - n_groups);
  const double between = of_means / std::max(1, n_groups - kUnknowns);
  return std::max(0.0, between - within) * n_groups / n_;
}

double LambertFitter::common_residual(const LambertFit& fit) {
  HAARLIGHT_EXPECTS(fit.state == PixelState::good, "a good fit");
  Matrix3d matrix;
  return std::sqrt(common_square(fit.b, matrix));
}

/// The model error common to neighbouring lights, over |b|, as the angle by which as much again
/// may have biased the normal unnoticed: sqrt(tr A^-1) of A = sum s s^T / n, perpendicular to
/// b, converts it into an angle.
double LambertFitter::common_error(const Vector3d& b) {
  Matrix3d matrix;
  const double shared = common_square(b, matrix);
  Matrix3d inverse;
  bool is_invertible = false;
  const double trace = matrix.trace();
  matrix.computeInverseWithCheck(inverse, is_invertible, kLeastRest * trace * trace * trace);
  if (!is_invertible) {
    return kRightAngle;
  }
  const Vector3d along = b.normalized();
  const double across = n_ * (inverse.trace() - along.dot(inverse * along));
  return std::sqrt(shared * std::max(0.0, across)) / b.norm();
}

double LambertFitter::sigma(const Vector3d& b, const Vector3d& plain) {
  accumulate();  // of the last weights
  residuals(b);
  // The samples in use were chosen for their small residuals: the noise follows from the median
  // of all.
  const ResidualSums left = residual_sums(w_.data(), r_.data(), n_);
  const double kept = std::sqrt(left.square / left.weight);
  const double noise = kSigmaPerMad * double{select(n_ / 2)};
  const double chosen = kept > 0.0 ? std::max(1.0, noise / kept) : 1.0;
  const double doubt = kDoubt * std::atan2(b.cross(plain).norm(), b.dot(plain));
  const double shared = kShared * common_error(b);
  const double all = std::hypot(std::min(kRightAngle, chosen * jackknife(b)), doubt, shared);
  return std::min(90.0, all * kDegrees);
}

/// The spread of the normals obtained by leaving out one group of lights after the other, at
/// the final weights: (G - 1) / G times the sum of their squared distances from the full normal
/// [Efron82]. Returned in radians.
double LambertFitter::jackknife(const Vector3d& b) const {
  const Vector3d n = b.normalized();
  double sum = 0.0;
  int n_groups = 0;
  for (int first = 0; first < n_;) {
    const int last = end_of_group(first);
    const Sums part = sums(first, last - first);
    first = last;
    if (!(part.matrix.trace() > 0.0)) {
      continue;  // none of its samples counts
    }
    ++n_groups;
    const Matrix3d rest = matrix_ - part.matrix;
    const double trace = rest.trace();
    Matrix3d inverse;
    bool is_invertible = false;
    rest.computeInverseWithCheck(inverse, is_invertible, kLeastRest * trace * trace * trace);
    if (!is_invertible) {
      return kRightAngle;
    }
    const Vector3d without = inverse * (right_ - part.right);
    const double length = without.norm();
    if (!(length > 0.0)) {
      return kRightAngle;
    }
    sum += (without / length - n).squaredNorm();
  }
  if (n_groups < 2) {
    return kRightAngle;
  }
  return std::min(kRightAngle, std::sqrt(sum * (n_groups - 1) / n_groups));
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
  const Vector3d plain = b;
  if (is_solved && options_.method == LambertMethod::trimmed) {
    trim(b);
  } else if (is_solved && options_.method == LambertMethod::m_estimator) {
    reweight(b);
  }
  // The smallest eigenvalue is at least 4 det / trace^2: usually that is enough.
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
  const ResidualSums left = residual_sums(w_.data(), r_.data(), n_);
  result.b = b;
  result.error = std::sqrt(left.square / left.weight) / length;
  result.n_used = left.n_used;
  if (options_.has_sigma) {
    result.sigma_deg = sigma(b, plain);
  }
  result.state = PixelState::good;
  return result;
}

}  // namespace haarlight::relight
