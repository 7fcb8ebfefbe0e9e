// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/light_query.h"

/// @file
/// What the kernels that sum in float have in common: factors in units of a power of two, the
/// bound on rounding, batches, and writing sums into pictures.

namespace haarlight::relight {

/// e with the largest |factor| in [2^(e-1), 2^e); 0 when all are zero.
[[nodiscard]] int unit_exponent(std::span<const double> factors);

/// A factor as the kernels take it, in units of 2^exponent. Below 2^-60 units it becomes 0, so
/// that no product and no sum ever underflows; float_sum_error() accounts for the loss.
[[nodiscard]] float in_units(double factor, int exponent);

/// How far factor * value can be off in a sum whose products undergo at most m roundings, as a
/// multiple of |value|: gamma_m |factor| with gamma_m = m u / (1 - m u), u = 2^-24 [Higham02,
/// lemma 3.1], or |factor| where the factor is taken as 0.
[[nodiscard]] double float_sum_error(double factor, int exponent, int n_roundings);

/// Square roots, rounded up to float.
[[nodiscard]] std::vector<float> root_round_up(std::span<const double> squares);

/// The queries of one channel, kBatch at a time.
[[nodiscard]] std::vector<std::vector<const LightQuery*>> batches_of_channel(
    const LightQueries& requested, int channel);

/// Puts sums[0], sums[stride], ... times 2^exponent into the query's picture: a tile's pixels,
/// row by row.
void put_sums(std::span<const float> sums, std::size_t stride, int exponent,
              const TileRect& rect, const LightQuery& query,
              std::vector<RelitPicture>& pictures);

}  // namespace haarlight::relight
