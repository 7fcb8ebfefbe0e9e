// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <string_view>

/// @file
/// What a real sheet of paper and a real camera add to a flat Lambertian target, each as one
/// number shared by all lights: how rough and how glossy the paper is, where its surface lies,
/// the residual of the lens model. Each has a prior standard deviation; a fit either determines
/// it or propagates it into its uncertainties. Notes: docs/numerics/near-light.md.

#include "haarlight/core/enum_words.h"

namespace haarlight::relight {

enum class SheetTerm : std::size_t {
  /// q = B / A of Oren and Nayar (1994), equation 30: the reflected light is
  /// 1 + q max(0, cos dphi) sin alpha tan beta times Lambert's.
  roughness,
  /// s: the reflected light is 1 + s (n.h)^10 times Lambert's, h halfway between the directions
  /// to the light and to the camera.
  sheen,
  height,  ///< of the sheet, mm along +z
  tilt_x,  ///< its rise to the edge at +x, mm
  tilt_y,  ///< to the edge at +y, mm
  bow_xx,  ///< a X^2, mm; X and Y: from the middle, 1 at half the longer side
  bow_xy,  ///< b X Y, mm
  bow_yy,  ///< c Y^2, mm
  lens,    ///< residual radial distortion at the picture's corner, relative
};
inline constexpr auto kSheetTermWords = std::to_array<std::string_view>(
    {"roughness", "sheen", "height", "tilt_x", "tilt_y", "bow_xx", "bow_xy", "bow_yy", "lens"});
constexpr std::span<const std::string_view> words_of(SheetTerm) { return kSheetTermWords; }
constexpr std::size_t kSheetTerms = 9;
constexpr double kSheenExponent = 10.0;

/// One number for each term: values, or standard deviations.
struct SheetValues {
  std::array<double, kSheetTerms> of{};
  [[nodiscard]] double& operator[](SheetTerm term) {
    return of[static_cast<std::size_t>(term)];
  }
  [[nodiscard]] double operator[](SheetTerm term) const {
    return of[static_cast<std::size_t>(term)];
  }
  [[nodiscard]] bool is_zero() const;
};

/// sigma: prior standard deviation of each term, about 0. 0: the term is fixed at 0; infinity:
/// no prior.
struct SheetPriors {
  SheetValues sigma;
  [[nodiscard]] bool is_free(SheetTerm term) const { return sigma[term] > 0.0; }
  [[nodiscard]] bool has_reflectance() const {
    return is_free(SheetTerm::roughness) || is_free(SheetTerm::sheen);
  }
};

/// Good matte paper laid flat by hand under a calibrated lens: any roughness, sheen 10 %, bow 1
/// mm in each of its three shapes, lens 0.5 %.
/// @param has_view  false: the camera's direction is not known, which roughness and sheen need
[[nodiscard]] SheetPriors matte_paper(bool has_view);

/// B / A from a facet slope sigma (rad), and back. 0 .. 0.54; monotone.
[[nodiscard]] double roughness_of_slope(double sigma);
[[nodiscard]] double slope_of_roughness(double q);

}  // namespace haarlight::relight
