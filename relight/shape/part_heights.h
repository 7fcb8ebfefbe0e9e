// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "core/image.h"
#include "relight/light/near_light.h"
#include "relight/shape/integrate_normals.h"
#include "relight/shape/pixel_samples.h"

/// @file
/// How high each connected part of a surface stands above the reference plane, from the near
/// lights' fall-off: normals do not tell it, but only at the right height does one normal a
/// pixel explain the brightness under every light. Errors: docs/numerics/shape.md, "How high".

namespace haarlight {

struct PartHeight {
  std::int64_t n_pixels = 0;
  double mean_mm = 0.0;  ///< mean height above the reference plane
  /// One standard error of it, by leaving out one group of neighbouring lights after the other,
  /// and of the part's pixels. Too small where the part has steps inside, by ten and more: it
  /// says whether anything is known, and is not shown to people.
  double sigma_mm = 0.0;
  bool is_known = false;  ///< false: the fall-off does not tell, or the part is too small
};

struct PartSearch {
  bool is_first = true;    ///< false: the points stand where an earlier search put them
  bool has_sigma = false;  ///< sigma_mm, which costs as much as a first search again
};

/// One a part, in the order of `parts`. At most kMostParts are looked at, the largest.
/// @param parts   of the pixels whose normals are known
/// @param points  (height, width, 3) mm: the surface's present shape; moved along the view, as
/// a
///                camera sees it
[[nodiscard]] std::vector<PartHeight> find_part_heights(
    const StackSource& stack, const StereoLights& lights, const PixelPoints& pixels,
    const Parts& parts, ImageView<const float> points, const PartSearch& options);

inline constexpr int kMostParts = 8;
inline constexpr int kLeastPartPixels = 30;

}  // namespace haarlight
