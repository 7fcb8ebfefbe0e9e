// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/plate/plate.h"

/// @file
/// The clean plate within one tile. As vectors over the lights, the plate's rows at
/// neighbouring pixels differ in length (the plane's texture, vignetting) and hardly in
/// direction: a tile stores the direction as a polynomial of the position in the tile, and a
/// pixel one number, its gain. The polynomial's error is not lost: it goes into the residual.
///
///     B(p) ~ gain(p) sum_j u_j(p) V_j,    u_j(p) = sum_t a[j][t] C_t(p)
///
/// with V the plate's vectors (plate.h) and C_t the products T_a(xi) T_b(eta) of Chebyshev
/// polynomials, a, b <= degree, t = b (degree + 1) + a, at xi = (2 x + 1)/width - 1 and
/// eta = (2 y + 1)/height - 1 of the tile's own x, y. Source: docs/reference/basis-format.md.

namespace haarlight::relight {

inline constexpr int kMaxPlateDegree = 8;
inline constexpr int kMaxPlateRank = 64;

/// C_t of every pixel of a tile, (pixels, (degree + 1)^2).
[[nodiscard]] std::vector<double> plate_terms(const TileRect& rect, int degree);

/// a[j][t] of one tile and channel, (rank, (degree + 1)^2), fitted by least squares to the unit
/// directions of the clean plate's rows; all 0 where no pixel of the tile sees the plate. A
/// closed-form source is evaluated at (degree + 2)^2 pixels, any other at all of them. Where
/// few pixels see the plate, the higher terms stay 0.
/// @param channel  of the plate
[[nodiscard]] std::vector<float> fit_tile_plate(const StackSource& plate, int channel,
                                                const TileRect& rect,
                                                const PlateVectors& vectors, int degree);

/// Unit direction of the clean plate over the lights at one pixel: sum_j u_j V_j.
/// @param terms  of this pixel
template <class Real>
void plate_direction(std::span<const float> tile_plate, std::span<const double> terms,
                     std::span<const float> vectors, std::span<Real> out);

/// sum_j factors_j u_j of every pixel of a tile: the clean plate at gain 1 under a light whose
/// products with the vectors are `factors`.
/// @param factors  (rank)
/// @param out      (pixels)
void plate_sums(const TileRect& rect, int degree, std::span<const float> tile_plate,
                std::span<const double> factors, std::span<double> out);

/// The smallest degree whose directions deviate from the clean plate's by no more than `target`
/// (rms over pixels between those fitted, in tiles spread over the picture), or by no more than
/// 1.05 times the best degree's deviation.
[[nodiscard]] int choose_plate_degree(const StackSource& plate, const PlateVectors& vectors,
                                      int tile, double target);

}  // namespace haarlight::relight
