// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "relight/calibration/light_likelihood.h"
#include "relight/calibration/target_samples.h"

/// @file
/// An array of lights of known layout: six unknowns of its pose, each light's power, one lobe
/// exponent, each point's albedo. Points are eliminated one by one; the remaining system is
/// dense in the lights. Notes: docs/numerics/near-light.md.

namespace haarlight::relight {

struct RigidArray {
  std::vector<Eigen::Vector3d> positions_mm;  ///< (K), in the array's frame
  std::vector<Eigen::Vector3d> axes;          ///< (K), unit, likewise: direction of emission
  /// Edges of each emitter in that frame, as in NearLight; empty: points.
  std::vector<Eigen::Matrix<double, 3, 2>> emitters_mm;
};

/// The lights at a pose, powers 1.
[[nodiscard]] std::vector<NearLight> array_at(const RigidArray& array,
                                              const Eigen::Isometry3d& world_from_array,
                                              double mu);

/// Standard deviations of a pose: a turn about the world's axes through the array's middle,
/// then a shift.
struct PoseBound {
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();  ///< rad, mm
  double mu = 0.0;
  SheetValues sheet;               ///< of the sheet's terms; 0: not fitted
  std::vector<LightBound> lights;  ///< (K), effect of the pose's error on each
};

/// The bound at a pose; options as in free_light_bounds().
/// @param lights  (K), at that pose, with their powers
/// @param albedo  (C, P)
[[nodiscard]] PoseBound rigid_bound(const TargetSamples& samples,
                                    std::span<const NearLight> lights,
                                    std::span<const double> albedo,
                                    const LikelihoodOptions& options = {});

struct RigidFit {
  Eigen::Isometry3d world_from_array = Eigen::Isometry3d::Identity();
  LikelihoodFit fit;
};

/// Levenberg-Marquardt from a pose. @throws Error  a light that starts below the surface at a
/// used sample
[[nodiscard]] RigidFit fit_rigid_array(const TargetSamples& samples, const RigidArray& array,
                                       const Eigen::Isometry3d& start,
                                       std::vector<NearLight> lights,
                                       const LikelihoodOptions& options = {});

/// As test_free_lights(). @param fit  with the lights at their pose
[[nodiscard]] ModelTest test_rigid_array(const TargetSamples& samples, const LikelihoodFit& fit,
                                         const LikelihoodOptions& options, double freedom);

}  // namespace haarlight::relight
