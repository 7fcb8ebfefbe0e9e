// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "haarlight/relight/shape/pixel_samples.h"

/// @file
/// The height of each connected part of a surface above the reference plane, from the near
/// lights' fall-off: normals do not determine it, but only at the right height does one normal
/// per pixel explain the brightness under every light. Errors: docs/numerics/shape.md, "How
/// high".

namespace haarlight::relight {

/// What a part's height is known from.
enum class HeightSource { none, fall_off, hull };

struct PartHeight {
  std::int64_t n_pixels = 0;
  double mean_mm = 0.0;  ///< mean height above the reference plane
  /// One standard error of it, by leaving out one group of neighbouring lights after the other,
  /// and of the part's pixels. Too small by a factor of ten or more if the part has internal
  /// steps: it only decides whether the height is known, and is not shown to the user.
  double sigma_mm = 0.0;
  bool is_known = false;  ///< false: not determined, or part too small
  HeightSource source = HeightSource::none;
  /// Between which mean heights the hull leaves the part; equal: no hull.
  double low_mm = 0.0;
  double high_mm = 0.0;
};

struct PartSearch {
  bool is_first = true;    ///< false: the points are where an earlier search put them
  bool has_sigma = false;  ///< sigma_mm, at the cost of another first search
};

/// One per part, in the order of `parts`. Only the kMostParts largest are searched.
/// @param parts   of the pixels whose normals are known
/// @param points  (height, width, 3) mm: the surface's current shape; moved along the view, as
///                a camera sees it
[[nodiscard]] std::vector<PartHeight> find_part_heights(
    const StackSource& stack, const StereoLights& lights, const PixelPoints& pixels,
    const Parts& parts, ImageView<const float> points, const PartSearch& options);

inline constexpr int kMostParts = 8;
inline constexpr int kLeastPartPixels = 30;

}  // namespace haarlight::relight
