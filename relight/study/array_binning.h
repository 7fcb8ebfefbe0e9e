// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/study/array_grid.h"

/// @file
/// The array with fewer lights: bins of side x side LEDs lit together (larger area lights, the
/// cells still without gaps), or one LED at the bin's middle instead of all (the same pitch, a
/// smaller light: with gaps). Both emit as much as the whole array did. The first loses
/// sharpness, the second casts separate shadows where the truth has one soft edge: aliasing.
/// Source: the claim of graceful degradation in [Kim13]; docs/numerics/bases.md, "Fewer
/// lights".

namespace haarlight::relight {

/// One way to light a bin.
struct BinChoice {
  int side = 2;
  bool is_area = true;
  int row = 0;  ///< of the light within its bin, if it is a single light
  int col = 0;
};

/// Sides 2 and 4, where they divide the grid and leave at least 2 bins per side; the area
/// first, then each of the four lights around the bin's middle.
[[nodiscard]] std::vector<BinChoice> bin_choices(const ArrayGrid& grid);

/// The lights' weights when the array is binned: the mean of the bin, or the bin's sum on one
/// light.
/// @param weights  (n_lights)
[[nodiscard]] Eigen::VectorXd binned_weights(const Eigen::VectorXd& weights,
                                             const ArrayGrid& grid, const BinChoice& choice);

/// Sum of squared errors of a pixel's lights when each is replaced by its bin.
/// @param lights  (n_lights)
[[nodiscard]] double binned_energy(std::span<const float> lights, const ArrayGrid& grid,
                                   const BinChoice& choice);

}  // namespace haarlight::relight
