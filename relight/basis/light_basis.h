// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/haar.h"

/// @file
/// What a basis over the lights of a pixel is, for basis files and for the comparison of bases
/// (relight/study), and the table of those that the program knows. Docs: docs/numerics/bases.md.

namespace haarlight::relight {

/// A transform over the lights of a pixel. Coefficients are scaled to orthonormal magnitude:
/// each is multiplied by the norm of the light pattern it represents, so that one threshold and
/// one quantiser serve all bases. Const calls are thread-safe.
class LightBasis {
 public:
  LightBasis() = default;
  virtual ~LightBasis() = default;
  LightBasis(const LightBasis&) = delete;
  LightBasis& operator=(const LightBasis&) = delete;

  [[nodiscard]] virtual int n_lights() const = 0;
  [[nodiscard]] virtual int n_coefficients() const = 0;
  /// The light patterns are orthonormal: errors of coefficients are errors of lights.
  [[nodiscard]] virtual bool is_orthonormal() const { return true; }
  /// All coefficients together reproduce the lights. False for a projection: what it misses
  /// cannot be coded.
  [[nodiscard]] virtual bool is_complete() const { return true; }
  /// True if coefficients are ordered by importance and the transform may be truncated after
  /// the first r.
  [[nodiscard]] virtual bool is_ranked() const { return false; }
  /// Bytes that each of the first `n` light patterns costs in the file; 0 where a formula
  /// defines them.
  [[nodiscard]] virtual std::size_t table_bytes(int) const { return 0; }

  /// @param lights        (n, n_lights)
  /// @param coefficients  (n, n_coefficients), at orthonormal magnitude
  virtual void analyse(std::span<const float> lights, std::span<float> coefficients) const = 0;
  /// The inverse of analyse(), or the projection where it has none.
  virtual void synthesise(std::span<const float> coefficients,
                          std::span<float> lights) const = 0;
  /// The same where all but the first `n` coefficients of a pixel are 0.
  virtual void synthesise_first(std::span<const float> coefficients, int /*n*/,
                                std::span<float> lights) const {
    synthesise(coefficients, lights);
  }
};

/// A basis that a formula defines, orthonormal, with a coefficient for every light: what a basis
/// file can be written in. Coefficients have light-domain indices: grid after grid, row * cols +
/// col within a grid.
class FixedBasis : public LightBasis {
 public:
  explicit FixedBasis(int n_lights);
  [[nodiscard]] int n_lights() const final { return n_lights_; }
  [[nodiscard]] int n_coefficients() const final { return n_lights_; }
  void analyse(std::span<const float> lights, std::span<float> coefficients) const final;
  void synthesise(std::span<const float> coefficients, std::span<float> lights) const final;

  /// In place on (n, n_lights). The inverse is the transpose.
  virtual void forward(std::span<float> rows) const = 0;
  virtual void forward(std::span<double> rows) const = 0;
  virtual void inverse(std::span<float> rows) const = 0;
  virtual void inverse(std::span<double> rows) const = 0;
  /// Some values of one row's inverse, the same bits.
  /// @param lights  indices @param values  (lights.size(),)
  virtual void inverse_at(std::span<const double> row, std::span<const int> lights,
                          std::span<double> values) const;

  /// Light-domain indices in the order in which a quantised file stores them, coarse first, and
  /// that order cut into groups: where each ends. By default the lights' own, by 64.
  [[nodiscard]] virtual std::vector<int> order() const;
  [[nodiscard]] virtual std::vector<int> group_ends() const;

  /// The lossless form for whole numbers, in place on one pixel's lights; see is_integer_basis().
  virtual void forward_integers(std::span<std::int64_t> lights) const;
  virtual void inverse_integers(std::span<std::int64_t> coefficients) const;

 private:
  int n_lights_;
};

/// What the lights of a basis must form.
enum class GridNeed {
  none,
  grids,          ///< rows and columns
  limited_grids,  ///< rows and columns, at most 1024 of each
  powers_of_two,  ///< the same, each a power of two
};

/// One basis of the program's table.
struct KnownBasis {
  std::string_view word;   ///< on the command line and in files
  std::string_view title;  ///< in tables
  GridNeed need = GridNeed::none;
  std::optional<BasisKind> kind;  ///< of a basis file; nothing: compress cannot write it
  std::string_view why_not;       ///< compress cannot write it; empty where it can
};
/// All of them, in the order of the tables.
[[nodiscard]] std::span<const KnownBasis> known_bases();
[[nodiscard]] const KnownBasis& known_basis(BasisKind kind);

/// Of which lights a basis of that need is, for messages: "lights in grids of ...".
[[nodiscard]] std::string_view grid_words(GridNeed need);
/// Why lights in such grids (0 x 0: in none) cannot have a basis of that need; empty: they can.
[[nodiscard]] std::string missing_grid(GridNeed need, const HaarGrid& grid);
/// The basis has a lossless form for whole numbers (BasisCoding::integers).
[[nodiscard]] bool is_integer_basis(BasisKind kind);

/// @param grid  of each face, in order; unused where the basis needs none
/// @throws ContractViolation  a grid that the basis cannot have (missing_grid()), lights that
///                            are not whole grids
[[nodiscard]] std::shared_ptr<const FixedBasis> make_basis(BasisKind kind, const HaarGrid& grid,
                                                           int n_lights);
[[nodiscard]] std::shared_ptr<const FixedBasis> make_basis(const BasisHeader& header);

}  // namespace haarlight::relight
