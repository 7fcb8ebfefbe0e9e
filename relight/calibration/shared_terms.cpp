// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/shared_terms.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Core>

#include "core/linear_algebra.h"

namespace haarlight::relight {

namespace {

constexpr int kPointDegree = 4;
constexpr int kLightDegree = 3;
constexpr int kLightsPerMode = 4;
// A mode explained by other unknowns up to this fraction carries no information of its own.
constexpr double kOwnFraction = 1e-8;

SheetTerm term_at(std::size_t i) { return static_cast<SheetTerm>(i); }

/// The longest single step of each term.
double longest_step(SheetTerm term) {
  switch (term) {
    case SheetTerm::roughness:
      return 0.3;
    case SheetTerm::sheen:
      return 0.1;
    case SheetTerm::lens:
      return 0.02;
    default:
      return 5.0;  // mm
  }
}

/// T_i(x) T_j(y), i + j <= degree, without the constant.
Eigen::ArrayXXd products(const Eigen::ArrayXd& x, const Eigen::ArrayXd& y, int degree) {
  const auto table = [degree](const Eigen::ArrayXd& v) {
    const double middle = 0.5 * (v.minCoeff() + v.maxCoeff());
    const Eigen::ArrayXd t = (v - middle) / std::max(v.maxCoeff() - middle, 1e-300);
    Eigen::ArrayXXd out(v.size(), degree + 1);
    out.col(0).setOnes();
    out.col(1) = t;
    for (int i = 2; i <= degree; ++i) {
      out.col(i) = 2.0 * t * out.col(i - 1) - out.col(i - 2);
    }
    return out;
  };
  const Eigen::ArrayXXd tx = table(x);
  const Eigen::ArrayXXd ty = table(y);
  Eigen::ArrayXXd out(x.size(), (degree + 1) * (degree + 2) / 2 - 1);
  Eigen::Index column = 0;
  for (int sum = 1; sum <= degree; ++sum) {
    for (int i = 0; i <= sum; ++i) {
      out.col(column++) = tx.col(i) * ty.col(sum - i);
    }
  }
  return out;
}

}  // namespace

TestModes test_modes(const TargetSamples& samples, std::span<const NearLight> lights) {
  const auto n = static_cast<Eigen::Index>(samples.n_points());
  Eigen::ArrayXd x(n);
  Eigen::ArrayXd y(n);
  for (Eigen::Index p = 0; p < n; ++p) {
    x[p] = samples.points_mm[static_cast<std::size_t>(p)].x();
    y[p] = samples.points_mm[static_cast<std::size_t>(p)].y();
  }
  int degree = kLightDegree;
  while (degree > 1 &&
         kLightsPerMode * (degree + 1) * (degree + 2) / 2 > static_cast<int>(lights.size())) {
    --degree;
  }
  const auto n_lights = static_cast<Eigen::Index>(lights.size());
  Eigen::ArrayXd light_x(n_lights);
  Eigen::ArrayXd light_y(n_lights);
  for (Eigen::Index k = 0; k < n_lights; ++k) {
    light_x[k] = lights[static_cast<std::size_t>(k)].position_mm.x();
    light_y[k] = lights[static_cast<std::size_t>(k)].position_mm.y();
  }
  return {products(x, y, kPointDegree), products(light_x, light_y, degree)};
}

ModelTest score_modes(const Eigen::MatrixXd& a, const Eigen::VectorXd& b,
                      const Eigen::VectorXd& direct, double chi2, double freedom) {
  ModelTest test;
  // In units of each mode's weight if no other unknown explained any of it.
  const Eigen::VectorXd unit = direct.cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const SymmetricEigen eigen = symmetric_eigen(unit.asDiagonal() * a * unit.asDiagonal());
  const Eigen::VectorXd along = eigen.vectors.transpose() * b.cwiseProduct(unit);
  double taken = 0.0;
  for (Eigen::Index i = 0; i < along.size(); ++i) {
    if (eigen.values[i] > kOwnFraction) {
      taken += along[i] * along[i] / eigen.values[i];
      ++test.n;
    }
  }
  const double left = freedom - test.n;
  if (test.n == 0 || left < 10.0) {
    return test;
  }
  test.is_done = true;
  const double noise = std::max((chi2 - taken) / left, 1e-300);
  test.chi2 = taken / noise;
  const Eigen::Index lobe = a.rows() - TestModes::kSuspects;
  if (a(lobe, lobe) > kOwnFraction * direct[lobe]) {
    test.lobe_z = b[lobe] / std::sqrt(a(lobe, lobe) * noise);
  }
  const double spread = 2.0 / (9.0 * test.n);
  test.z = (std::cbrt(test.chi2 / test.n) - (1.0 - spread)) / std::sqrt(spread);
  return test;
}

SharedTerms::SharedTerms(bool is_mu_free, const SheetPriors& priors, const TestModes* modes)
    : is_mu_free_(is_mu_free), priors_(priors), modes_(modes) {
  n_model_ = is_mu_free ? 1 : 0;
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    const bool is_free = priors.is_free(term_at(i));
    n_model_ += is_free ? 1 : 0;
    has_sheet_ = has_sheet_ || is_free;
  }
}

void SharedTerms::fill(const TargetColumns& target, const LightTerms& terms, int light,
                       Eigen::Ref<Eigen::MatrixXd> out) const {
  Eigen::Index column = 0;
  if (is_mu_free_) {
    out.col(column++) = terms.log_cos.matrix();
  }
  Eigen::ArrayXd per_height;
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    const SheetTerm term = term_at(i);
    if (!priors_.is_free(term)) {
      continue;
    }
    auto to = out.col(column++).array();
    if (term == SheetTerm::roughness || term == SheetTerm::sheen) {
      const Eigen::ArrayXd& from = term == SheetTerm::sheen ? terms.sheen : terms.roughness;
      if (from.size() > 0) {
        to = from;
      } else {
        to.setZero();  // the camera's direction is not known
      }
    } else if (term == SheetTerm::lens) {
      to = -(terms.position * target.per_lens).rowwise().sum();
    } else {
      if (per_height.size() == 0) {
        per_height = -(terms.position * target.per_height).rowwise().sum();
      }
      const auto j = static_cast<Eigen::Index>(i - static_cast<std::size_t>(SheetTerm::height));
      to = per_height * target.height.col(j) - terms.normal.col(0) * target.slope_x.col(j) -
           terms.normal.col(1) * target.slope_y.col(j);
    }
  }
  for (Eigen::Index l = 0; modes_ != nullptr && l < modes_->light.cols(); ++l) {
    const Eigen::Index m = modes_->target.cols();
    out.middleCols(column, m) = modes_->light(light, l) * modes_->target.matrix();
    column += m;
  }
  if (modes_ != nullptr) {
    out.col(column) = terms.log_cos.min(0.0).exp().acos().square().matrix();
  }
}

double SharedTerms::add_priors(const SheetValues& sheet, Eigen::Ref<Eigen::MatrixXd> matrix,
                               Eigen::Ref<Eigen::VectorXd> rhs) const {
  Eigen::Index at = is_mu_free_ ? 1 : 0;
  double chi2 = 0.0;
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    const SheetTerm term = term_at(i);
    if (!priors_.is_free(term)) {
      continue;
    }
    const double precision = 1.0 / (priors_.sigma[term] * priors_.sigma[term]);
    matrix(at, at) += precision;
    rhs[at] -= precision * sheet[term];
    chi2 += precision * sheet[term] * sheet[term];
    ++at;
  }
  return chi2;
}

void SharedTerms::take(const Eigen::VectorXd& step, double& mu, SheetValues& sheet) const {
  Eigen::Index at = 0;
  if (is_mu_free_) {
    mu = mu + step[at] > 0.0 ? mu + step[at] : 0.5 * mu;
    ++at;
  }
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    const SheetTerm term = term_at(i);
    if (priors_.is_free(term)) {
      sheet[term] += std::clamp(step[at], -longest_step(term), longest_step(term));
      ++at;
    }
  }
}

SheetValues SharedTerms::sigmas(const Eigen::MatrixXd& covariance) const {
  SheetValues out;
  Eigen::Index at = is_mu_free_ ? 1 : 0;
  for (std::size_t i = 0; i < kSheetTerms; ++i) {
    if (priors_.is_free(term_at(i))) {
      out[term_at(i)] = std::sqrt(std::max(covariance(at, at), 0.0));
      ++at;
    }
  }
  return out;
}

}  // namespace haarlight::relight
