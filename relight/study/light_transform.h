// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

/// @file
/// A transform over the lights of a pixel, for the comparison of bases. Coefficients are scaled
/// to orthonormal magnitude: each is multiplied by the norm of the light pattern it represents,
/// so that one threshold and one quantiser serve all bases. Source: docs/numerics/bases.md.

namespace haarlight::relight {

/// Lights in rows x cols grids, faces one after the other; rows = 0: in no grid.
struct ArrayGrid {
  int rows = 0;
  int cols = 0;
  int n_faces = 0;
  [[nodiscard]] bool is_grid() const noexcept { return rows > 0; }
  [[nodiscard]] int n_face() const noexcept { return rows * cols; }
};

/// Const calls are thread-safe.
class LightTransform {
 public:
  LightTransform() = default;
  virtual ~LightTransform() = default;
  LightTransform(const LightTransform&) = delete;
  LightTransform& operator=(const LightTransform&) = delete;

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

/// The lights themselves: the cost without any transform.
[[nodiscard]] std::unique_ptr<LightTransform> make_direct_transform(int n_lights);

/// 2-D Haar, nonstandard (haar.h) or standard: every row through all levels, then every column.
/// @throws ContractViolation  rows or cols beyond 1024; standard: not a power of two
[[nodiscard]] std::unique_ptr<LightTransform> make_haar_transform(const ArrayGrid& grid,
                                                                  bool is_standard);

/// Orthonormal 2-D DCT-II of each face [Ahmed74]: any number of rows and columns.
[[nodiscard]] std::unique_ptr<LightTransform> make_dct_transform(const ArrayGrid& grid);

/// CDF 5/3 over each face by lifting (dyadic_transform.h). Biorthogonal.
[[nodiscard]] std::unique_ptr<LightTransform> make_cdf53_transform(const ArrayGrid& grid);

}  // namespace haarlight::relight
