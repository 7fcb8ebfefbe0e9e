// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/progress.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "relight/reflectance/fit/picture_rows.h"
#include "relight/reflectance/fit/plane_writer.h"

/// @file
/// A fit whose planes are the same sums of the lights' values for every pixel: one pass over
/// the pictures, 16-bit planes, then 8-bit ones, whose ranges are known by then.

namespace haarlight::relight {

/// What to compute for every pixel.
struct FarFit {
  /// Basis, colour, terms, lights, axes; no planes and no scales yet.
  ReflectanceModel model;
  /// rgb: (n_terms, n_lights), for each channel; lrgb: the same, for the luminance factor; pca:
  /// (n_terms, 3 * n_lights), light by light R, G, B.
  Eigen::MatrixXd matrix;
  Eigen::VectorXd added;  ///< (n rows of matrix)
};

struct FarFitOptions {
  PlaneOptions planes{};
  ProgressStyle progress = ProgressStyle::none;
};

/// @throws Error  as the rows do; no disk space for 16-bit planes
[[nodiscard]] FitResult fit_far(PictureRows& rows, const FarFit& fit,
                                const FarFitOptions& options = {});

/// The planes of one pixel, not quantised. The reference for tests, and for samples.
/// @param values  (3 * n_lights), light by light R, G, B, 0..1
[[nodiscard]] Eigen::VectorXd planes_of(const FarFit& fit, const Eigen::VectorXd& values);

}  // namespace haarlight::relight
