// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

#include "relight/study/light_transform.h"

/// @file
/// The array with fewer lights: bins of side x side LEDs lit together (larger area lights, the
/// cells still without gaps), or one LED of the bin's middle in place of all (the same pitch, a
/// smaller light: with gaps). Both give off what the whole array gave. The first loses
/// sharpness, the second casts separate shadows where the truth has one soft edge: aliasing.
/// Source: the claim of graceful degradation in [Kim13]; docs/numerics/bases.md, "Fewer
/// lights".

namespace haarlight {

/// One way to light a bin.
struct BinChoice {
  int side = 2;
  bool is_area = true;
  int row = 0;  ///< of the light within its bin, where it is one light
  int col = 0;
};

/// Sides 2 and 4, where they divide the grid and leave at least 2 bins a side; the area first,
/// then each of the four lights around the bin's middle.
[[nodiscard]] std::vector<BinChoice> bin_choices(const ArrayGrid& grid);

/// What the lights burn at when the array is binned: the mean of the bin, or the bin's sum at
/// one light.
/// @param weights  (n_lights)
[[nodiscard]] Eigen::VectorXd binned_weights(const Eigen::VectorXd& weights,
                                             const ArrayGrid& grid, const BinChoice& choice);

/// Squares of what a pixel's lights are off by when each stands in its bin.
/// @param lights  (n_lights)
[[nodiscard]] double binned_energy(std::span<const float> lights, const ArrayGrid& grid,
                                   const BinChoice& choice);

}  // namespace haarlight
