// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/core/enum_words.h"
#include "relight/calibration/light_likelihood.h"
#include "relight/calibration/rigid_likelihood.h"
#include "relight/calibration/target_samples.h"

/// @file
/// Positions and powers of a capture's lights from pictures of a matte target: free lights, or
/// an array whose layout is known. Two stages: the normalised variance of [Huang15] by L-BFGS
/// on coarse samples, which converges from far away, then maximum likelihood on all samples,
/// which attains the bound. Notes, gauges and measured errors: docs/numerics/near-light.md.

namespace haarlight::relight {

/// The lobe exponent, one for all lights.
enum class Lobe {
  free,   ///< an unknown
  given,  ///< each light's own mu, from a data sheet or the rig file
  paper,  ///< isotropic, mu = 0, as in [Huang15]
};
inline constexpr auto kLobeWords = std::to_array<std::string_view>({"free", "given", "paper"});
constexpr std::span<const std::string_view> words_of(Lobe) { return kLobeWords; }
/// How far the fit goes.
enum class Stage {
  variance,    ///< the paper's objective alone, on coarse samples
  likelihood,  ///< then maximum likelihood
};

/// Where free lights start.
enum class Start {
  uniform_albedo,  ///< each light alone first, assuming a uniform albedo
  given,           ///< at the given positions, as in the paper
};

struct CalibrationOptions {
  Start start = Start::uniform_albedo;
  Lobe lobe = Lobe::free;
  double mu_start = 1.0;  ///< where `free` starts
  Stage stage = Stage::likelihood;
  MaskOptions mask;
  /// Samples that deviate from their model by more than this fraction and by 6 standard
  /// deviations are left out as shadowed or outlying; 0: none are.
  double outlier_fraction = 0.2;
  int coarse_points = 144;    ///< approximate number of blocks in the first stage
  int max_iterations = 3000;  ///< of L-BFGS, for Stage::variance
  /// The same if the likelihood follows: it needs only a point near the minimum.
  int max_first_iterations = 300;
  double shape_tolerance =
      0.2;  ///< a position less certain than this fraction of its height is weak
  /// Aiming error of lights with an aim, rad, standard deviation in each of two directions;
  /// each is then an unknown. Used only by Stage::likelihood.
  double aim_sigma = 0.0;
  /// Uncertainties of the sheet and the lens: none by default, which is right for a flat
  /// Lambertian target. Used only by Stage::likelihood.
  SheetPriors sheet;
  std::function<bool()> should_stop = {};
};

/// The outcome for one light.
enum class LightFinding {
  good,
  weak,    ///< the samples do not constrain it in one direction: see weak_direction
  unseen,  ///< not one usable sample; its position is the start's
};

struct CalibratedLight {
  NearLight light;
  /// Of the fit: the bound, enlarged where the samples fit worse than noise. Meaningless if
  /// LightCalibration::test did not pass.
  LightBound sigma;
  SampleCounts counts;
  LightFinding finding = LightFinding::good;
  Eigen::Vector3d weak_direction = Eigen::Vector3d::Zero();  ///< unit; the least certain one
  double weak_mm = 0.0;                                      ///< standard deviation along it
};

struct LightCalibration {
  std::vector<CalibratedLight> lights;  ///< (K), mean power 1 in each channel
  std::vector<double> albedo;           ///< (C, P), albedo times vignetting, units of intensity
  double mu = 0.0;
  double mu_sigma = 0.0;  ///< 0: not fitted
  double variance = 0.0;  ///< D at the end, on the coarse samples
  /// chi^2 of all samples over (samples - unknowns); 1 where the model and the noise are right.
  /// NaN after Stage::variance.
  double reduced_chi2 = 0.0;
  SheetValues sheet;        ///< of the terms that were unknowns
  SheetValues sheet_sigma;  ///< 0: not fitted
  /// Whether the model explains the pictures. Not done after Stage::variance or with too few
  /// samples.
  ModelTest test;
  int n_variance_iterations = 0;
  int n_likelihood_iterations = 0;
  bool has_converged = false;
  /// Of a rigid array.
  std::optional<Eigen::Isometry3d> world_from_array;
  std::optional<PoseBound> pose_sigma;

  /// Converged, and at least one light is good.
  [[nodiscard]] bool is_usable() const;
  /// The test was done and failed: the pictures hold something that no unknown of the model can
  /// follow, and every sigma is wrong.
  [[nodiscard]] bool is_model_wrong() const { return test.is_done && !test.is_passed(); }
  /// "1024 lights: 1020 good, 3 weak, 1 unseen; mu 1.002 +- 0.004; chi^2 1.00; ..."
  [[nodiscard]] std::string brief_report() const;
};

/// All lights over the target's middle at the height of its longer side, as in the paper;
/// facing down (the lobe's axis).
[[nodiscard]] std::vector<NearLight> paper_start(const TargetSamples& samples, double mu);

/// Lights whose axes are known: each `distance_mm` away from the target's middle, against its
/// axis, so that the middle is in its lobe. @throws Error  an axis that does not point down
[[nodiscard]] std::vector<NearLight> start_along_axes(const TargetSamples& samples,
                                                      std::span<const Eigen::Vector3d> axes,
                                                      double distance_mm, double mu);

/// Unknowns: 3 K positions, K C powers, an exponent. Heights over the target's highest point
/// are exponentials: a light cannot end up below it. Axes are those of `start`.
/// @throws Error  fewer than two lights with samples, indistinguishable lights (coincident, so
///                that the albedo explains everything); says what is missing
[[nodiscard]] LightCalibration calibrate_free_lights(TargetSamples samples,
                                                     std::vector<NearLight> start,
                                                     const CalibrationOptions& options = {});

/// Unknowns: 6 of the pose, K C powers, an exponent. `start` positions the array roughly:
/// within a third of its distance and about 20 degrees.
/// @throws Error  as above; an array that starts below the target
[[nodiscard]] LightCalibration calibrate_rigid_array(TargetSamples samples,
                                                     const RigidArray& array,
                                                     const Eigen::Isometry3d& start,
                                                     const CalibrationOptions& options = {});

}  // namespace haarlight::relight
