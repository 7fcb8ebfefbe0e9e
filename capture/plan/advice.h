// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "core/rig/pattern_inverse.h"
#include "haarlight/capture/plan/plan.h"
#include "haarlight/core/rig/rig.h"

/// @file
/// Which patterns are worth using: from the camera's noise, the lights' signal and the rig's
/// limits, predicts the quality that each family of patterns will reach under stated lightings,
/// before anything is lit. Model and its check against the simulator:
/// docs/numerics/patterns.md. A target of its own; the daemon does not link it. Pure.
///
/// At a pixel, with T_k electrons from light k alone (full drive, the rig's exposure E0), a
/// shot j of exposure E = x E0 collects mu_j = x sum_k P_jk T_k with variance
///
///     v_j = r^2 + g^2/12 + mu_j + (flicker mu_j)^2        (read, rounding, photons, the
///     lights)
///
/// Relit with light weights w the picture is sum_j a_j M_j / x, a =
/// PatternInverse::shot_weights(w), so
///
///     noise^2 = sum_j a_j^2 v_j / x^2 + (sum_j a_j)^2 (r^2 + g^2/12) / (n_darks x^2)
///     bias    = sum_k (w_k - sum_j a_j P_jk) T_k          (what the shots do not contain)
///
/// both averaged over pixels and colours; PSNR = 10 log10(peak^2 / (noise^2 + bias^2)) with the
/// 99.9th percentile of the exact picture as peak. For one light of an S-matrix of n shots and
/// an object of s electrons per light: gain^2 = (r^2 + s) / (4 r^2/n + 2 s) [Schechner07].

namespace haarlight::capture {

/// What the camera will see, at a sample of pixels.
struct AdviceScene {
  int n_lights = 0;
  int n_pixels = 0;
  /// (n_pixels, n_lights): electrons at full drive and the rig's exposure.
  std::vector<float> electrons;
  /// (n_pixels, n_lights): noise variance of a pilot's `electrons`; empty: none.
  std::vector<float> variance;
  /// (n_pixels, n_lights): the clean plate that develop will use, any unit; empty: none.
  std::vector<float> plate;
  /// False: an empty plane, or a pilot that lit several lights at once: light within a block is
  /// not resolved, so no bias can be predicted.
  bool resolves_lights = false;
  std::string source;  ///< for display
};

/// The empty plane: `lit_electrons` at the clean plate's median pixel under the mean light.
/// @param plate  (n_pixels, n_lights)
[[nodiscard]] AdviceScene plate_scene(std::vector<float> plate, int n_lights,
                                      double lit_electrons);

/// What the pictures will be relit with. Several columns (colours, or single lights) are
/// averaged into one figure.
struct AdviceLighting {
  std::string name;
  Eigen::MatrixXd weights;  ///< (n_lights, any number), not negative
};

/// Single lights, `n` of them spread over the rig: the quality of one light's picture.
[[nodiscard]] AdviceLighting single_lights(int n_lights, int n);

struct AdviceOptions {
  double flicker = 0.0;    ///< relative rms change of a shot's light from one time to the next
  double target_db = 0.0;  ///< required PSNR under every lighting; 0: none
  /// How far the brightest pixel stays below saturation: mean + this many sigmas.
  double sigmas = 4.0;
};

/// Quality under one lighting. Electrons refer to the rig's exposure.
struct Prediction {
  std::string lighting;
  double peak_e = 0.0;
  double noise_e = 0.0;  ///< rms
  double bias_e = 0.0;   ///< rms; NaN: unknown without a pilot
  /// Uncertainty (1 sigma) of bias_e^2, from the pilot's own noise.
  double bias2_sigma = 0.0;
  double noise_psnr_db = 0.0;  ///< with zero bias
  double psnr_db = 0.0;        ///< NaN when the bias is unknown
};

/// One way to capture, assessed.
struct FamilyAdvice {
  std::string name;
  Plan plan;  ///< its shots at `exposure_us`; without shots when no plan is possible
  DryRun cost;
  double exposure_us = 0.0;
  double brightest_e = 0.0;  ///< mean of the brightest pixel's brightest shot at E0
  double limit_e = 0.0;      ///< the clip level (session/clip_level.h)
  std::vector<Prediction> predictions;
  std::vector<std::string> refusals;  ///< why not, with the arithmetic; empty: usable
  std::vector<std::string> notes;     ///< arithmetic worth knowing
};

struct Advice {
  std::vector<FamilyAdvice> families;
  int best = -1;  ///< of those not refused: the fastest that reaches the target everywhere, or
                  ///< without a target the best worst-case PSNR; -1: none
};

/// gain^2 of an S-matrix of n shots over single lights of s electrons and read noise r.
[[nodiscard]] double s_matrix_gain2(double read_e, double signal_e, int n);

/// One prediction. @param n_darks  frames averaged into the dark; 0: none is subtracted
[[nodiscard]] Prediction predict(const PatternInverse& inverse, const AdviceScene& scene,
                                 const CameraSpec& camera, double exposure_us, int n_darks,
                                 const AdviceLighting& lighting, const AdviceOptions& options);

/// The inverse that develop will use for a plan.
[[nodiscard]] PatternInverse inverse_of(const Plan& plan);

/// Assesses plans. Each is tried at the rig's exposure (or its own first one) and, where that
/// saturates, at the longest that does not; PWM periods, power, strings and duty are respected.
/// @param settings  e.g. default_families(); @param own  weights for the lighting patterns
[[nodiscard]] Advice advise(const Rig& rig, const AdviceScene& scene,
                            const std::vector<AdviceLighting>& lightings,
                            const std::vector<PlanSettings>& settings, const Lighting* own,
                            const AdviceOptions& options = {});

/// One at a time; bins of 16, 64 and 256 shots per face where they fit; S-matrix; with a
/// lighting its wavelets and its target shot. Darks as develop needs them.
[[nodiscard]] std::vector<PlanSettings> default_families(const Rig& rig, bool has_lighting);

}  // namespace haarlight::capture
