// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/progress.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "relight/reflectance/fit/picture_rows.h"
#include "relight/reflectance/fit/plane_writer.h"

/// @file
/// Fits under near lights: values are normalised to one distance first, then each pixel is
/// fitted with its own light directions. Source: Huang et al., "Near Light Correction for Image
/// Relighting and 3D Shape Recovery", section V.A, eq. 10. Method, cost and error:
/// docs/numerics/reflectance-fits.md, "Near lights".

namespace haarlight::relight {

/// Positions of lights and pixels.
struct NearGeometry {
  std::vector<NearLight> lights;  ///< (n_lights)
  PixelPoints points;
  /// Values become those of lights at this distance; 0: the lights' mean distance from the
  /// picture's middle.
  double reference_mm = 0.0;
};

enum class NearSolve {
  exact,  ///< every pixel its own least-squares problem
  /// The solution's matrix on a grid of pixels, cubic interpolation in between.
  interpolated,
};
inline constexpr auto kNearSolveWords =
    std::to_array<std::string_view>({"exact", "interpolated"});
constexpr std::span<const std::string_view> words_of(NearSolve) { return kNearSolveWords; }

struct NearFitOptions {
  ReflectanceBasis basis = ReflectanceBasis::hsh;  ///< ptm or hsh, in rgb
  int n_terms = 9;
  double ridge = 1e-4;  ///< as LightInterpolation::ridge
  NearSolve solve = NearSolve::exact;
  int grid = 64;  ///< interpolated: largest number of pixels between grid nodes
  /// The transfer applied to the corrected values before the fit: viewers expect srgb. The rows
  /// are linear in either case.
  Transfer transfer = Transfer::srgb;
  PlaneOptions planes{};
  ProgressStyle progress = ProgressStyle::none;
};

/// @param rows  linear
/// @throws Error  a light at or behind a pixel's surface point; lights that separate too few
///                terms (with a hint); what the rows throw
[[nodiscard]] FitResult fit_near(PictureRows& rows, const NearGeometry& geometry,
                                 const NearFitOptions& options);

/// The planes of one pixel, in double: the reference.
/// @param values  (3 * n_lights) linear, light by light R, G, B
/// @param x, y    the pixel's centre: column + 0.5, row + 0.5
[[nodiscard]] Eigen::VectorXd near_planes_of(const NearGeometry& geometry,
                                             const NearFitOptions& options,
                                             const Eigen::VectorXd& values, double x, double y);

}  // namespace haarlight::relight
