// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "relight/reflectance/formats/reflectance.h"

/// @file
/// How a value under a light that was not photographed is made of those that were: a sum with
/// weights that depend on directions alone, the same for every pixel. Polynomials and harmonics
/// with ridge, kriging, and normalised Gaussians. Source: Malzbender et al. (2001) and Gautron
/// et al. (2004) for the terms; Cressie, "Statistics for Spatial Data" (1993), 3.4 for kriging
/// with a drift; Dubrule (1983) for its closed-form leave-one-out. Pure; thread-safe.

namespace haarlight {

enum class RecipeKind {
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

struct LightRecipe {
  RecipeKind kind = RecipeKind::terms;
  ReflectanceBasis basis = ReflectanceBasis::hsh;  ///< terms: ptm or hsh
  int n_terms = 9;                                 ///< terms
  KrigingKernel kernel = KrigingKernel::thin_plate;
  LightSpace space = LightSpace::sphere;
  double width = 0.5;  ///< matern, radial
  /// terms: added to the normal equations, times a term's order squared (a light's share is
  /// 1 / n_lights); kriging and radial: variance of what is noise.
  double ridge = 0.0;
};
[[nodiscard]] std::string to_string(const LightRecipe& recipe);

/// The terms of directions, (n, n_terms).
[[nodiscard]] Eigen::MatrixXd terms_of(ReflectanceBasis basis, int n_terms,
                                       const std::vector<Eigen::Vector3d>& directions);

/// How much each term bends, (n_terms): what the ridge is multiplied by. Harmonics of order l:
/// (l (l + 1) / 2)^2, the squared Laplacian's share; PTM: 1 for squares and product, 0.3 for u
/// and v, 0 for the constant.
[[nodiscard]] Eigen::VectorXd ridge_shape(ReflectanceBasis basis, int n_terms);

/// The fit's matrix, (n_terms, n_lights): coefficients = matrix * values. Lights that cannot
/// tell all terms apart: the least coefficients (ridge 0) or what the ridge says.
[[nodiscard]] Eigen::MatrixXd term_matrix(const LightRecipe& recipe,
                                          const std::vector<Eigen::Vector3d>& lights);

/// Values at `directions` = weights * values at lights; (n_directions, n_lights).
[[nodiscard]] Eigen::MatrixXd recipe_weights(const LightRecipe& recipe,
                                             const std::vector<Eigen::Vector3d>& lights,
                                             const std::vector<Eigen::Vector3d>& directions);

/// Residual of each light when it is predicted from the others: (n_lights, n_lights), row i
/// times the values is light i's own value minus its prediction. Rows of NaN where the others
/// do not determine it.
[[nodiscard]] Eigen::MatrixXd leave_one_out(const LightRecipe& recipe,
                                            const std::vector<Eigen::Vector3d>& lights);

/// radial: values at the Gaussians' centres, the lights, from those photographed; (n_lights,
/// n_lights). Between the centres knot_weights() of relight/reflectance/formats/reflectance.h
/// counts.
[[nodiscard]] Eigen::MatrixXd radial_centres(const LightRecipe& recipe,
                                             const std::vector<Eigen::Vector3d>& lights);

/// How well lights tell a basis' terms apart.
struct TermsCondition {
  int rank = 0;
  double condition = 0.0;     ///< largest by smallest singular value; infinite where deficient
  Eigen::VectorXd ambiguous;  ///< where deficient: unit combination of terms that no light sees
};
[[nodiscard]] TermsCondition terms_condition(ReflectanceBasis basis, int n_terms,
                                             const std::vector<Eigen::Vector3d>& lights);

/// What is wrong with a set of directions, for people; empty where nothing is.
/// Lights fewer than terms, two in one place, all in one plane (with the direction that stays
/// ambiguous), below the horizon.
[[nodiscard]] std::vector<std::string> light_warnings(
    const std::vector<Eigen::Vector3d>& lights);

}  // namespace haarlight
