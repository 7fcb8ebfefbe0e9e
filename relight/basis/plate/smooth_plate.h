// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/plate/plate.h"

/// @file
/// A computed clean plate from few of its pixels: over a tile, each light's irradiance is an
/// analytic function of position, so that its values at (D + 1)^2 Chebyshev nodes determine all
/// others, and over the lights the rows lie close to a space of few vectors Q:
///
///     B(p) ~ sum_i y_i(p) Q_i,    y_i(p) = sum_t c[i][t] C_t(p)
///
/// with C_t as in tile_plate.h, of degree D. Method, cost, errors: docs/numerics/relight.md,
/// "What a plate costs".

namespace haarlight::relight {

/// Degree that brings every tile within `target` by the theory of Chebyshev series (Bernstein:
/// the error falls by rho per degree, rho from the distance of the nearest singularity: a
/// light, the plane's horizon); nothing where a tile sees only part of the plane, crosses the
/// plane of a light, or has a singularity too near for degree kMaxSmoothDegree.
inline constexpr int kMaxSmoothDegree = 12;
[[nodiscard]] std::optional<int> smooth_degree(const ComputedPlate& plate, int tile,
                                               double target);

/// The clean plate's rows in coordinates of Q. As a StackSource its "lights" are the vectors.
class SmoothPlate final : public StackSource {
 public:
  /// @param degree     from smooth_degree()
  /// @param target     PlateVectors::missed of the vectors chosen for the file, over all pixels
  /// @param max_rank   of them
  SmoothPlate(const ComputedPlate& plate, int tile, int degree, double target, int max_rank);

  [[nodiscard]] StackDims dims() const override;
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  [[nodiscard]] bool is_closed_form() const override { return true; }

  /// y of every pixel of tile i (row by row), (n_vectors, pixels).
  [[nodiscard]] Eigen::MatrixXd tile_coordinates(int i_tile) const;
  [[nodiscard]] TileRect tile_rect(int i_tile) const;
  [[nodiscard]] int n_tiles() const;
  [[nodiscard]] int n_vectors() const { return static_cast<int>(vectors_.cols()); }
  /// Q, (n_lights, n_vectors), orthonormal; the first PlateVectors::rank are the chosen ones.
  [[nodiscard]] const Eigen::MatrixXd& vectors() const { return vectors_; }
  [[nodiscard]] const PlateVectors& chosen() const { return chosen_; }
  /// The chosen vectors in coordinates of Q: for fit_tile_plate() of this source.
  [[nodiscard]] PlateVectors chosen_here() const;

 private:
  void turn(double target, int max_rank);
  [[nodiscard]] Eigen::MatrixXd node_rows(const ComputedPlate& plate, int i_tile) const;

  StackDims dims_;  ///< of the plate
  int tile_;
  int degree_;
  Eigen::MatrixXd vectors_;
  PlateVectors chosen_;
  std::vector<Eigen::MatrixXd> series_;  ///< of each tile: c, (n_vectors, (degree + 1)^2)
};

}  // namespace haarlight::relight
