// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"

/// @file
/// Sets of lights shown together: used to shoot, and to recover single-light pictures
/// afterwards (core/rig/pattern_inverse.h). A pattern is one weight per light in [0, 1]; the
/// measured picture is the weighted sum of the lights' pictures. When to use which:
/// docs/numerics/patterns.md. Pure.

namespace haarlight {

/// One row per shot, one column per light.
using PatternMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

enum class PatternFamily {
  list,           ///< patterns written by hand; undone by least squares
  one_at_a_time,  ///< one shot per light
  bins,           ///< blocks of lights; distributed over the block by the clean plate
  s_matrix,       ///< about half of all lights in every shot [Sloane79]
  haar,           ///< positive and negative lights of Haar wavelets, all of them or some
  target,  ///< one shot (per colour) with every light at the drive level an environment needs
};
inline constexpr auto kPatternFamilyWords = std::to_array<std::string_view>(
    {"list", "one_at_a_time", "bins", "s_matrix", "haar", "target"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(PatternFamily) noexcept {
  return kPatternFamilyWords;
}

/// Lights in rows and columns, in row-major order.
struct FaceGrid {
  int rows = 0;
  int cols = 0;
  [[nodiscard]] int n_lights() const { return rows * cols; }
  friend bool operator==(const FaceGrid&, const FaceGrid&) = default;
};

/// The parameters a plan and a session must record for its shots to become single lights.
struct PatternParameters {
  PatternFamily family = PatternFamily::list;
  std::vector<FaceGrid> faces;  ///< in the lights' order; empty for list and target
  int bin = 0;                  ///< side of a block, for bins
  /// For haar: which coefficients, face * n^2 + row * n + col as haarlight/relight/basis/haar.h numbers
  /// them; each face's mean (index 0 of the face) is always one of them.
  std::vector<int> wavelets;
  [[nodiscard]] int n_lights() const;  ///< of all faces; clamped to INT_MAX
  friend bool operator==(const PatternParameters&, const PatternParameters&) = default;
};

/// The lit lights of every shot, for any family but list and target, in the canonical order
/// that core/rig/pattern_inverse.h expects: faces one after the other; bins row by row;
/// S-matrix rows, then the light left over; for haar the mean, or the positive and the negative
/// lights, of each wavelet of the list.
/// @throws ContractViolation  a grid that the family does not fit (see fits())
[[nodiscard]] std::vector<std::vector<int>> lit_lights(const PatternParameters& parameters);
/// True when lit_lights() accepts the parameters.
[[nodiscard]] bool fits(const PatternParameters& parameters);

/// True when there is an S-matrix of this order [Sloane79]: rows of 0 and 1 with (order + 1)/2
/// ones. For 2^k - 1 Sylvester's, entry (i, j) = parity of (i + 1) & (j + 1), which has a fast
/// inverse; for other primes 3 mod 4 from the quadratic residues.
[[nodiscard]] bool has_s_matrix(int order);
/// True when the order is 2^k - 1, k >= 2.
[[nodiscard]] bool is_sylvester(int order);
/// One entry of it. @param shot, light  0 .. order - 1
[[nodiscard]] bool s_entry(int order, int shot, int light);

/// An S-matrix over a run of lights, or (order 1) a single light.
struct SBlock {
  int first_light = 0;
  int n_lights = 0;
  int order = 1;  ///< shots; columns beyond n_lights are not lit
};
/// How n lights are divided into blocks: 2^k lights take the order 2^k - 1 and one light alone,
/// all other counts the smallest order that holds them.
[[nodiscard]] std::vector<SBlock> s_blocks(int n_lights);

/// A wavelet of the n x n grid by its position (row, col) in the coefficient array.
struct Wavelet {
  int row0 = 0;  ///< corner of its square
  int col0 = 0;
  int size = 0;       ///< side of its square; its values are +-1/size
  bool is_x = false;  ///< changes sign from left to right
  bool is_y = false;  ///< changes sign from top to bottom; neither: the mean
  /// +1 or -1 inside its square, 0 outside.
  [[nodiscard]] int sign(int row, int col) const;
};
/// @param index  row * n + col, 0 .. n^2 - 1
[[nodiscard]] Wavelet wavelet_at(int n, int index);

}  // namespace haarlight
