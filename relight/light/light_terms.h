#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/light/target_samples.h"

/// @file
/// The stencil of one light at all points of a target, with its derivatives: what the
/// likelihood of free lights and of a rigid array are both built from.

namespace haarlight {

/// Points and normals as columns.
struct TargetColumns {
  explicit TargetColumns(const TargetSamples& samples);
  Eigen::ArrayX3d point;   ///< (P, 3), mm
  Eigen::ArrayX3d normal;  ///< (P, 3)
};

/// h = cos^mu(off-axis) (n.w) / |w|^3, w = l - p, and the derivatives of ln h.
struct LightTerms {
  Eigen::ArrayXd h;          ///< (P), mm^-2; 0 where there is no light
  Eigen::ArrayXd log_cos;    ///< (P), d ln h / d mu
  Eigen::ArrayX3d position;  ///< (P, 3), d ln h / d l, mm^-1
  Eigen::ArrayX3d axis;      ///< (P, 3), d ln h / d axis; empty unless asked for
  bool reaches_used = true;  ///< h > 0 at every used sample
};
/// @param used  (P), 0: masked
[[nodiscard]] LightTerms light_terms(const TargetColumns& target, const NearLight& light,
                                     const std::uint8_t* used, bool has_axis);

/// Inverse variances of samples, (K, C, P), 0 where masked: what a fit holds fixed.
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

/// Scales each channel's powers to mean 1 over the lights in use, the albedo the other way.
/// @param albedo  (C, P)
void fix_power_scale(const TargetSamples& samples, std::span<NearLight> lights,
                     std::span<double> albedo);

/// Lights with at least one used sample, (K).
[[nodiscard]] std::vector<bool> lights_in_use(const TargetSamples& samples);

}  // namespace haarlight
