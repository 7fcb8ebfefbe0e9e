// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <span>

#include <Eigen/Core>

#include "relight/calibration/light_terms.h"
#include "relight/calibration/sheet_model.h"

/// @file
/// The unknowns shared by all lights, as columns of d ln h: the lobe's exponent, the sheet's
/// terms, and, for the test of the model, smooth functions of light and point together.

namespace haarlight::relight {

/// Products of a polynomial in the light's position and one in the point's. Constants are left
/// out: they are absorbed by power and albedo. Then specific suspects: the lobe's angle
/// squared, present if the lobe is not a power of a cosine.
struct TestModes {
  Eigen::ArrayXXd target;  ///< (P, M)
  Eigen::ArrayXXd light;   ///< (K, L)
  static constexpr Eigen::Index kSuspects = 1;
  [[nodiscard]] Eigen::Index size() const { return target.cols() * light.cols() + kSuspects; }
};
/// Chebyshev polynomials up to degree 4 of the point's x and y, up to 3 of the light's; lower
/// where there are fewer than four lights for each of the latter.
[[nodiscard]] TestModes test_modes(const TargetSamples& samples,
                                   std::span<const NearLight> lights);

/// Whether the pictures contain something smooth that the fitted model cannot follow.
struct ModelTest {
  double chi2 = 0.0;    ///< what the test modes would explain, over the remaining noise
  int n = 0;            ///< independent modes: expectation of chi2 if the model is right
  double z = 0.0;       ///< chi2 as a standard normal (Wilson and Hilferty, 1931)
  double lobe_z = 0.0;  ///< of the lobe's shape alone, a standard normal
  bool is_done = false;
  /// Pictures that fit the model exceed one of the two once in about 5000 calibrations.
  static constexpr double kMostZ = 3.72;
  static constexpr double kMostLobeZ = 3.89;
  [[nodiscard]] bool is_passed() const {
    return is_done && z < kMostZ && std::abs(lobe_z) < kMostLobeZ;
  }
};
/// From the test modes' own equations, all other unknowns eliminated: A x = b.
/// @param chi2_per_freedom  of the fit, taken as the noise scale where it is not 1
[[nodiscard]] ModelTest score_modes(const Eigen::MatrixXd& a, const Eigen::VectorXd& b,
                                    const Eigen::VectorXd& direct, double chi2, double freedom);

/// The columns and their order: mu, the sheet's free terms, test modes.
class SharedTerms {
 public:
  SharedTerms(bool is_mu_free, const SheetPriors& priors, const TestModes* modes = nullptr);

  [[nodiscard]] Eigen::Index n_model() const { return n_model_; }
  [[nodiscard]] Eigen::Index n_test() const { return modes_ != nullptr ? modes_->size() : 0; }
  [[nodiscard]] Eigen::Index size() const { return n_model_ + n_test(); }
  [[nodiscard]] WantedTerms wanted(bool has_axis) const { return {has_axis, has_sheet_}; }

  /// d ln h of one light. @param out  (P, size()), the caller's
  void fill(const TargetColumns& target, const LightTerms& terms, int light,
            Eigen::Ref<Eigen::MatrixXd> out) const;
  /// Adds the priors to the equations. @return  its chi^2
  [[nodiscard]] double add_priors(const SheetValues& sheet, Eigen::Ref<Eigen::MatrixXd> matrix,
                                  Eigen::Ref<Eigen::VectorXd> rhs) const;
  /// Takes a step, no longer than the linear model can be trusted.
  void take(const Eigen::VectorXd& step, double& mu, SheetValues& sheet) const;
  /// Standard deviations from the shared unknowns' covariance (n_model x n_model).
  [[nodiscard]] SheetValues sigmas(const Eigen::MatrixXd& covariance) const;

 private:
  bool is_mu_free_;
  SheetPriors priors_;
  const TestModes* modes_;
  Eigen::Index n_model_ = 0;
  bool has_sheet_ = false;
};

}  // namespace haarlight::relight
