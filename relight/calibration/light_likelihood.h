// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/calibration/shared_terms.h"
#include "relight/calibration/sheet_model.h"
#include "relight/calibration/target_samples.h"

/// @file
/// Free lights by maximum likelihood, and how well they can be known at all. The likelihood is
/// normal with the samples' noise; unknowns are each light's place and power, a lobe exponent
/// that all share, and each point's albedo. Given the albedo the lights are independent: their
/// 4 x 4 blocks are eliminated, and the points and the exponent are solved for together
/// (a Schur complement). Notes: docs/numerics/near-light.md.

namespace haarlight {

/// How well one light is known: standard deviations of the Cramer-Rao bound.
struct LightBound {
  /// Of the position, mm^2.
  Eigen::Matrix3d position_mm2 = Eigen::Matrix3d::Zero();
  double power = 0.0;  ///< relative
};

struct LightBounds {
  std::vector<LightBound> lights;  ///< (K)
  double mu = 0.0;                 ///< 0: the exponent was given
  SheetValues sheet;               ///< of the sheet's terms; 0: not fitted
};

/// How the coupling of the points through the lights is solved.
enum class Coupling {
  automatic,  ///< dense up to 600 points, then modes
  dense,      ///< exact: 2 K P^2 operations and P^3 / 3
  /// What couples points are smooth functions of the place on the target: polynomials of degree
  /// up to 11 hold it. Fits are solved to the end by conjugate gradients with these modes, and
  /// lose nothing; bounds take the modes alone.
  modes,
};

struct LikelihoodOptions {
  bool is_mu_free = true;
  bool is_albedo_known = false;  ///< for bounds alone
  Coupling coupling = Coupling::automatic;
  int max_iterations = 200;
  /// Ends when a step would lower chi^2 by less than this: parameters then lie within about the
  /// square root of it, in standard deviations, all of them together.
  double tolerance_chi2 = 0.02;
  std::function<bool()> should_stop = {};
  /// > 0: each light's axis may be off its aim by so much, rad, a standard deviation in each of
  /// two directions, and is an unknown; for lights with an aim alone, which must share mu.
  double aim_sigma = 0.0;
  SheetPriors sheet;        ///< which of the sheet's terms are unknown; none unless said
  SheetValues sheet_start;  ///< where a fit begins and where a bound is taken
};

/// The bound at `lights` for these points, masks and noise. Intensities are not looked at.
/// With several channels the bound of a statistic that joins them: exact where the channels'
/// noise is in one proportion everywhere. The common scale of power and albedo is fixed by
/// mean power = 1 (albedo unknown) or by the albedo.
/// @param albedo  (C, P), in units of intensity per power and stencil
[[nodiscard]] LightBounds free_light_bounds(const TargetSamples& samples,
                                            std::span<const NearLight> lights,
                                            std::span<const double> albedo,
                                            const LikelihoodOptions& options = {});

/// Lights and albedo that maximise the likelihood.
struct LikelihoodFit {
  std::vector<NearLight> lights;  ///< (K), mean power 1
  std::vector<double> albedo;     ///< (C, P), albedo times vignetting; 0 where nothing was used
  SheetValues sheet;
  double chi2 = 0.0;           ///< over the used samples, and what was known of the sheet
  std::int64_t n_samples = 0;  ///< used, all channels
  int n_iterations = 0;
  bool has_converged = false;
};

/// Levenberg-Marquardt from `lights`. A light without a used sample stays where it is.
/// Heights over the highest point keep their sign: they are moved by factors.
/// @throws Error  a light that starts behind a used sample
[[nodiscard]] LikelihoodFit fit_free_lights(const TargetSamples& samples,
                                            std::vector<NearLight> lights,
                                            const LikelihoodOptions& options = {});

/// What smooth functions of light and point would still take from a fit's residuals, every
/// unknown of the fit set free again: a score test, so nothing is fitted anew.
/// @param freedom  samples less unknowns of the fit
[[nodiscard]] ModelTest test_free_lights(const TargetSamples& samples, const LikelihoodFit& fit,
                                         const LikelihoodOptions& options, double freedom);

/// Albedo and powers, given where the lights are: alternating least squares in a few sweeps
/// from the lights' own powers, weighted by the samples' own noise or by `inverse_variance`,
/// (K, C, P). Mean power of each channel 1.
struct PowerFit {
  std::vector<NearLight> lights;
  std::vector<double> albedo;  ///< (C, P)
};
[[nodiscard]] PowerFit fit_powers(const TargetSamples& samples, std::vector<NearLight> lights,
                                  int n_sweeps = 8,
                                  std::span<const float> inverse_variance = {},
                                  const SheetValues& sheet = {});

}  // namespace haarlight
