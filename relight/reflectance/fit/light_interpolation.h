// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// Interpolates values under lights that were not photographed from those that were: a sum with
/// weights that depend only on directions, the same for every pixel. Polynomials and harmonics
/// with ridge, kriging, and normalised Gaussians. Source: Malzbender et al. (2001) and Gautron
/// et al. (2004) for the terms; Cressie, "Statistics for Spatial Data" (1993), 3.4 for kriging
/// with a drift; Dubrule (1983) for its closed-form leave-one-out. Pure; thread-safe.

namespace haarlight::relight {

enum class InterpolationKind {
  terms,    ///< least squares on PTM or HSH terms
  kriging,  ///< the smoothest field of a kernel about the drift 1, x, y, z
  radial,   ///< Gaussians around the lights, normalised to sum 1
};

enum class KrigingKernel {
  linear,      ///< -r
  thin_plate,  ///< r^2 log r
  cubic,       ///< r^3
  matern,      ///< (1 + t) exp(-t), t = sqrt(3) r / width
};

/// Where distances between lights are measured.
enum class LightSpace {
  sphere,  ///< between the unit vectors
  disc,    ///< between their x, y: lights near the horizon count as close together
};

struct LightInterpolation {
  InterpolationKind kind = InterpolationKind::terms;
  ReflectanceBasis basis = ReflectanceBasis::hsh;  ///< terms: ptm or hsh
  int n_terms = 9;                                 ///< terms
  KrigingKernel kernel = KrigingKernel::thin_plate;
  LightSpace space = LightSpace::sphere;
  double width = 0.5;  ///< matern, radial
  /// terms: added to the normal equations, times a term's order squared (each light contributes
  /// 1 / n_lights); kriging and radial: noise variance.
  double ridge = 0.0;
};
[[nodiscard]] std::string describe(const LightInterpolation& interpolation);

/// The terms at the directions, (n, n_terms).
[[nodiscard]] Eigen::MatrixXd terms_of(ReflectanceBasis basis, int n_terms,
                                       const std::vector<Eigen::Vector3d>& directions);

/// Roughness of each term, (n_terms): the factor of the ridge. Harmonics of order l: (l (l + 1)
/// / 2)^2, from the squared Laplacian; PTM: 1 for squares and product, 0.3 for u and v, 0 for
/// the constant.
[[nodiscard]] Eigen::VectorXd ridge_shape(ReflectanceBasis basis, int n_terms);

/// The fit's matrix, (n_terms, n_lights): coefficients = matrix * values. If the lights cannot
/// separate all terms: the minimum-norm coefficients (ridge 0), or as regularised by the ridge.
[[nodiscard]] Eigen::MatrixXd term_matrix(const LightInterpolation& interpolation,
                                          const std::vector<Eigen::Vector3d>& lights);

/// Values at `directions` = weights * values at lights; (n_directions, n_lights).
[[nodiscard]] Eigen::MatrixXd interpolation_weights(
    const LightInterpolation& interpolation, const std::vector<Eigen::Vector3d>& lights,
    const std::vector<Eigen::Vector3d>& directions);

/// Residual of each light when it is predicted from the others: (n_lights, n_lights), row i
/// times the values is light i's own value minus its prediction. Rows of NaN where the others
/// do not determine it.
[[nodiscard]] Eigen::MatrixXd leave_one_out(const LightInterpolation& interpolation,
                                            const std::vector<Eigen::Vector3d>& lights);

/// radial: values at the Gaussians' centres, the lights, from those photographed; (n_lights,
/// n_lights). Between the centres, node_weights() of haarlight/relight/reflectance/formats/reflectance.h
/// applies.
[[nodiscard]] Eigen::MatrixXd radial_centres(const LightInterpolation& interpolation,
                                             const std::vector<Eigen::Vector3d>& lights);

/// How well lights separate a basis's terms.
struct TermsCondition {
  int rank = 0;
  double condition = 0.0;  ///< largest over smallest singular value; infinite where deficient
  Eigen::VectorXd ambiguous;  ///< where deficient: unit combination of terms that no light sees
};
[[nodiscard]] TermsCondition terms_condition(ReflectanceBasis basis, int n_terms,
                                             const std::vector<Eigen::Vector3d>& lights);

/// Warnings for the user about a set of directions; empty if there are none. Fewer lights than
/// terms, coincident lights, all in one plane (with the direction that stays ambiguous), below
/// the horizon.
[[nodiscard]] std::vector<std::string> light_warnings(
    const std::vector<Eigen::Vector3d>& lights);

}  // namespace haarlight::relight
