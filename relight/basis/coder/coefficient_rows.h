// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

/// @file
/// The coder's loops over the lights of a pixel. Every sum is formed in the order of the lights
/// or of the pixels, so that it has the same bits for vectors of any width. Pure; safe from any
/// thread.

namespace haarlight::relight {

/// Of several rows: sums[k] += rows[i][k]^2, row after row.
/// @param rows  (n_rows, n)
/// @return  the largest absolute value; not finite where any value is not
float add_squares(std::span<const float> rows, std::size_t n_rows, double* sums);
double add_squares(std::span<const double> rows, std::size_t n_rows, double* sums);
/// The same, and each row's sum of squares. @param rows  (each.size(), n)
float add_squares(std::span<const float> rows, double* sums, std::span<double> each);

/// The sum of squares of each of several rows, eight abreast: one alone would wait for each
/// addition.
/// @param rows  (sums.size(), n)
void sum_squares(std::span<const float> rows, std::span<double> sums);
void sum_squares(std::span<const double> rows, std::span<double> sums);

/// A pixel's coefficients in whole steps: quanta[k] = quantise(row[k], 1 / step), and in row[k]
/// what rounding adds to the coefficient. Squares of the decoded coefficients
/// and of these errors are added to `energies` and `errors`.
void quantise_row(double step, std::span<float> row, std::int32_t* quanta, double* energies,
                  double* errors);
void quantise_row(double step, std::span<double> row, std::int32_t* quanta, double* energies,
                  double* errors);

inline constexpr std::size_t kSpareIndices = 16;
/// Where numbers are not 0, ascending. @param at  room for kSpareIndices more than numbers
/// @return  how many
std::size_t find_nonzero(std::span<const std::int32_t> numbers, std::uint32_t* at);

/// out = t - gain * direction; t itself where the gain is 0.
void subtract_plate(std::span<const float> t, double gain, std::span<const float> direction,
                    float* out);
void subtract_plate(std::span<const float> t, double gain, std::span<const double> direction,
                    double* out);

}  // namespace haarlight::relight
