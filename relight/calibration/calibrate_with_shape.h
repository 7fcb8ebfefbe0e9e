// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/calibration/near_calibration.h"

/// @file
/// Lights and the shape of a target that is not flat, in turn: lights given the shape, normals
/// and albedo given the lights, heights from the normals; until nothing moves. [Huang15],
/// section IV. Notes: docs/numerics/near-light.md.

namespace haarlight {

/// Normals and albedo by least squares on intensities freed of distance, lobe and power
/// (equations 4 and 5), one 3 x 3 system a point and channel 0.
struct PointNormals {
  std::vector<Eigen::Vector3d> normals;  ///< (P), unit; the samples' own where unsolved
  std::vector<double> albedo;            ///< (P), 0 where unsolved
  std::size_t n_unsolved = 0;            ///< fewer than 3 used lights, or directions in a plane
};
/// @throws Error  no point can be solved: all lights' directions lie in one plane, with the
///                direction that nobody knows
[[nodiscard]] PointNormals solve_normals(const TargetSamples& samples,
                                         std::span<const NearLight> lights);

/// Heights from normals: the points' new places, in the samples' order. Where a constant is
/// free (parallel projection) it is the caller's to fix.
using SurfaceFromNormals = std::function<std::vector<Eigen::Vector3d>(
    const TargetSamples& samples, std::span<const Eigen::Vector3d> normals)>;

struct AlternationOptions {
  CalibrationOptions lights;
  int max_rounds = 60;
  double tolerance_mm = 0.001;  ///< rms of what a round would move the points by
};

struct Alternation {
  LightCalibration lights;
  std::vector<Eigen::Vector3d> points_mm;
  std::vector<Eigen::Vector3d> normals;
  std::vector<double> moves_mm;  ///< rms of what each round would move the points by
  std::vector<double> chi2;      ///< reduced, of each round's lights
  bool has_converged = false;
};

/// Rounds are joined by Anderson mixing: alone they move the slow modes by a few per cent each.
/// The first round takes the samples' points and normals as they come: flat, usually.
/// @throws Error  as its steps do
[[nodiscard]] Alternation calibrate_with_shape(TargetSamples samples,
                                               std::vector<NearLight> start,
                                               const SurfaceFromNormals& surface,
                                               const AlternationOptions& options = {});

}  // namespace haarlight
