// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/calibration/sheet_model.h"
#include "relight/calibration/target_samples.h"

/// @file
/// The stencil of one light at all points of a target, with its derivatives: the basis of both
/// likelihoods, of free lights and of a rigid array.

namespace haarlight::relight {

/// Points and normals as columns, displaced by the sheet's own terms.
struct TargetColumns {
  explicit TargetColumns(const TargetSamples& samples, const SheetValues& sheet = {});
  Eigen::ArrayX3d point;   ///< (P, 3), mm
  Eigen::ArrayX3d normal;  ///< (P, 3)
  Eigen::ArrayX3d view;    ///< (P, 3), unit, to the camera; (0, 3) if unknown
  Eigen::ArrayX3d across;  ///< (P, 3), the part of `view` in the surface; likewise
  Eigen::ArrayXd cos_view;
  double roughness = 0.0;
  double sheen = 0.0;
  // How the surface's terms move a point (height 1 mm along the camera's ray), and lens.
  Eigen::ArrayX3d per_height;  ///< (P, 3)
  Eigen::ArrayX3d per_lens;    ///< (P, 3), mm
  Eigen::ArrayXXd height;      ///< (P, 6), mm per unit: height, tilts, bows
  Eigen::ArrayXXd slope_x;     ///< (P, 6), its derivative along x
  Eigen::ArrayXXd slope_y;
};

/// h = mean over the emitter of cos^mu(off-axis) (n.w) / |w|^3 times the sheet's reflectance
/// over Lambert's, w = l - p, and the derivatives of ln h.
struct LightTerms {
  Eigen::ArrayXd h;          ///< (P), mm^-2; 0 where there is no light
  Eigen::ArrayXd log_cos;    ///< (P), d ln h / d mu
  Eigen::ArrayX3d position;  ///< (P, 3), d ln h / d l, mm^-1, the axis held
  Eigen::ArrayX3d axis;      ///< (P, 3), d ln h / d axis; empty unless requested, or aimed
  Eigen::ArrayX3d normal;    ///< (P, 3), of Lambert's cosine by n; empty unless requested
  Eigen::ArrayXd roughness;  ///< (P); empty unless requested and the view is known
  Eigen::ArrayXd sheen;      ///< (P); likewise
  bool reaches_used = true;  ///< h > 0 at every used sample
};
/// Derivatives to compute besides those by position and exponent.
struct WantedTerms {
  bool axis = false;
  bool sheet = false;
};
/// @param used  (P), 0: masked
[[nodiscard]] LightTerms light_terms(const TargetColumns& target, const NearLight& light,
                                     const std::uint8_t* used, WantedTerms wanted = {});

/// d ln h / d l, mm^-1, (P, 3): the axis of a light with an aim follows.
[[nodiscard]] Eigen::Matrix<double, Eigen::Dynamic, 3> per_position(const LightTerms& terms,
                                                                    const NearLight& light);

/// Inverse variances of samples, (K, C, P), 0 where masked: held fixed in a fit.
[[nodiscard]] std::vector<float> inverse_variances(const TargetSamples& samples,
                                                   const TargetColumns& target,
                                                   std::span<const NearLight> lights,
                                                   std::span<const double> albedo);

/// One light's samples against its model m = albedo power h, channels joined: weights
/// w = sum_c m^2 / sigma^2, w_rho = sum_c (m^2 / sigma^2)(I/m - 1).
struct LightResidual {
  Eigen::ArrayXd w;      ///< (P)
  Eigen::ArrayXd w_rho;  ///< (P)
  double chi2 = 0.0;
};
[[nodiscard]] LightResidual light_residual(const TargetSamples& samples, int light,
                                           const LightTerms& terms,
                                           const Eigen::Vector3d& power,
                                           std::span<const double> albedo,
                                           std::span<const float> inverse_variance);

/// Scales each channel's powers to mean 1 over the lights in use, and the albedo inversely.
/// @param albedo  (C, P)
void fix_power_scale(const TargetSamples& samples, std::span<NearLight> lights,
                     std::span<double> albedo);

/// Lights with at least one used sample, (K).
[[nodiscard]] std::vector<bool> lights_in_use(const TargetSamples& samples);

}  // namespace haarlight::relight
