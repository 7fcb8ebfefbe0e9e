// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "relight/reflectance/fit/far_fit.h"
#include "relight/reflectance/fit/light_interpolation.h"
#include "relight/reflectance/fit/light_sample.h"

/// @file
/// Chooses the fit for a capture: every light in turn is predicted from the others, and the
/// parameters with the highest mean PSNR are taken. Because a fit is a sum over
/// lights that is the same for every pixel, its error at a light left out is a quadratic form
/// in the lights' products: hundreds of candidates cost less than one pass over the pictures.
/// Method and figures: docs/numerics/reflectance-fits.md.

namespace haarlight::relight {

/// What can be written.
enum class FitForm { ptm, lptm, hsh4, hsh9, hsh16, rbf, bilinear };
inline constexpr auto kFitFormWords = std::to_array<std::string_view>(
    {"ptm", "lptm", "hsh4", "hsh9", "hsh16", "rbf", "bilinear"});
constexpr std::span<const std::string_view> words_of(FitForm) { return kFitFormWords; }

struct FormOptions {
  int max_planes = 27;  ///< of 8 bits
  int resolution = 24;  ///< bilinear: grid points per side
  /// Given instead of chosen: the terms' ridge; the others' noise.
  std::optional<double> ridge{};
};

/// A form with the parameters that best predict lights left out.
struct FormScore {
  FitForm form = FitForm::ptm;
  LightInterpolation interpolation;
  int n_planes = 0;
  /// Mean over the lights of the PSNR at a light left out, dB, before rounding to 8 bits;
  /// includes the loss of PCA.
  double psnr_db = 0.0;
};

/// All candidate parameters of a form.
[[nodiscard]] std::vector<LightInterpolation> candidates_of(FitForm form,
                                                            const FormOptions& options);

/// Mean PSNR at lights left out with given parameters, dB. `products` as
/// LightSample::products(). Minus infinity where some light is not determined by the others.
/// @param dropped  additional mean square error
[[nodiscard]] double left_out_psnr(const LightInterpolation& interpolation,
                                   const std::vector<Eigen::Vector3d>& lights,
                                   const Eigen::MatrixXd& products, double dropped = 0.0);

/// The best parameters of each form that fits max_planes, best form first.
/// @throws Error  no light
[[nodiscard]] std::vector<FormScore> score_forms(const std::vector<FitForm>& forms,
                                                 const std::vector<Eigen::Vector3d>& lights,
                                                 const LightSample& sample,
                                                 const FormOptions& options);

/// The fit defined by a form and its parameters; PCA's axes come from the sample.
[[nodiscard]] FarFit make_far_fit(FitForm form, const LightInterpolation& interpolation,
                                  const std::vector<Eigen::Vector3d>& lights,
                                  const LightSample& sample, const FormOptions& options);

/// The direction of a grid point of the octahedral map.
[[nodiscard]] Eigen::Vector3d octahedral_direction(int row, int column, int resolution);

}  // namespace haarlight::relight
