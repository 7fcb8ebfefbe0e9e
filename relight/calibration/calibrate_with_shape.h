// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/calibration/near_calibration.h"

/// @file
/// Lights and the shape of a non-flat target by alternation: lights given the shape, normals
/// and albedo given the lights, heights from the normals; until convergence. [Huang15], section
/// IV. Notes: docs/numerics/near-light.md.

namespace haarlight::relight {

/// Normals and albedo by least squares on intensities corrected for distance, lobe and power
/// (equations 4 and 5), one 3 x 3 system per point, channel 0.
struct PointNormals {
  std::vector<Eigen::Vector3d> normals;  ///< (P), unit; the samples' own where unsolved
  std::vector<double> albedo;            ///< (P), 0 where unsolved
  std::size_t n_unsolved = 0;            ///< fewer than 3 used lights, or coplanar directions
};
/// @throws Error  no point can be solved: all lights' directions lie in one plane; names the
///                undetermined direction
[[nodiscard]] PointNormals solve_normals(const TargetSamples& samples,
                                         std::span<const NearLight> lights);

/// Heights from normals: the points' new positions, in the samples' order. Where a constant is
/// free (parallel projection), the caller must fix it.
using SurfaceFromNormals = std::function<std::vector<Eigen::Vector3d>(
    const TargetSamples& samples, std::span<const Eigen::Vector3d> normals)>;

struct AlternationOptions {
  CalibrationOptions lights;
  int max_rounds = 60;
  double tolerance_mm = 0.001;  ///< rms distance by which a round would move the points
};

struct Alternation {
  LightCalibration lights;
  std::vector<Eigen::Vector3d> points_mm;
  std::vector<Eigen::Vector3d> normals;
  std::vector<double> moves_mm;  ///< rms distance by which each round would move the points
  std::vector<double> chi2;      ///< reduced, of each round's lights
  bool has_converged = false;
};

/// Rounds are accelerated by Anderson mixing: alone they move the slow modes by a few per cent
/// each. The first round takes the samples' points and normals as given: usually flat.
/// @throws Error  as its steps do
[[nodiscard]] Alternation calibrate_with_shape(TargetSamples samples,
                                               std::vector<NearLight> start,
                                               const SurfaceFromNormals& surface,
                                               const AlternationOptions& options = {});

}  // namespace haarlight::relight
