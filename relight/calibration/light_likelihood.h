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
/// normal with the samples' noise; unknowns are each light's position and power, a lobe
/// exponent shared by all, and each point's albedo. Given the albedo the lights are
/// independent: their 4 x 4 blocks are eliminated, and the points and the exponent are solved
/// jointly (a Schur complement). Notes: docs/numerics/near-light.md.

namespace haarlight::relight {

/// The uncertainty of one light: standard deviations of the Cramer-Rao bound.
struct LightBound {
  /// Covariance of the position, mm^2.
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
  /// The coupling of points is smooth over the target: polynomials of degree up to 11 capture
  /// it. Fits are solved to convergence by conjugate gradients with these modes as
  /// preconditioner, and lose nothing; bounds use the modes alone.
  modes,
};

struct LikelihoodOptions {
  bool is_mu_free = true;
  bool is_albedo_known = false;  ///< for bounds only
  Coupling coupling = Coupling::automatic;
  int max_iterations = 200;
  /// Stops when a step without damping would lower chi^2 by less than this: all parameters
  /// together are then within about its square root, in standard deviations. Also where only
  /// damped steps of a twentieth of this are left, in a curved valley: a light so far away that
  /// its distance is unknown.
  double tolerance_chi2 = 0.02;
  std::function<bool()> should_stop = {};
  /// > 0: standard deviation of each light's aiming error in each of two directions, rad; the
  /// axis is then an unknown; only for lights with an aim, which must share mu.
  double aim_sigma = 0.0;
  SheetPriors sheet;        ///< which of the sheet's terms are unknown; default: none
  SheetValues sheet_start;  ///< where a fit starts and where a bound is evaluated
};

/// The bound at `lights` for these points, masks and noise. Intensities are not used. With
/// several channels, the bound of a statistic that combines them: exact where the channels'
/// noise ratio is the same everywhere. The common scale of power and albedo is fixed by mean
/// power = 1 (albedo unknown) or by the albedo.
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
  double chi2 = 0.0;           ///< over the used samples and the sheet's priors
  std::int64_t n_samples = 0;  ///< used, all channels
  int n_iterations = 0;
  bool has_converged = false;
};

/// Levenberg-Marquardt from `lights`. A light without a used sample stays where it is. Heights
/// over the highest point keep their sign: steps multiply them.
/// @throws Error  a light that starts below the surface at a used sample
[[nodiscard]] LikelihoodFit fit_free_lights(const TargetSamples& samples,
                                            std::vector<NearLight> lights,
                                            const LikelihoodOptions& options = {});

/// How much of a fit's residuals smooth functions of light and point would still explain, with
/// every unknown of the fit free again: a score test, so nothing is refitted.
/// @param freedom  samples minus unknowns of the fit
[[nodiscard]] ModelTest test_free_lights(const TargetSamples& samples, const LikelihoodFit& fit,
                                         const LikelihoodOptions& options, double freedom);

/// Albedo and powers given the light positions: alternating least squares in a few sweeps from
/// the lights' own powers, weighted by the samples' own noise or by `inverse_variance`, (K, C,
/// P). Mean power of each channel 1.
struct PowerFit {
  std::vector<NearLight> lights;
  std::vector<double> albedo;  ///< (C, P)
};
[[nodiscard]] PowerFit fit_powers(const TargetSamples& samples, std::vector<NearLight> lights,
                                  int n_sweeps = 8,
                                  std::span<const float> inverse_variance = {},
                                  const SheetValues& sheet = {});

}  // namespace haarlight::relight
