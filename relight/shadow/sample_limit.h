// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

/// @file
/// What the mean of a skewed population is at most, by a sample of it.

namespace haarlight::relight {

/// The sample's mean and, with z = 3, n values and their skewness s,
///
///     z + g (1 + 2 z^2)/6 + g^2 (z + 2 z^3)/9,   g = s/sqrt(n) >= 0,
///
/// standard errors of it: the first two terms are those of [Johnson78] for skewed populations,
/// the last one, of second order, is a margin for the rare large values that a small sample has
/// not seen. Squared errors of a picture are skewed: most receivers have none, a few at the
/// shadows' edges have nearly all. A symmetric sample gets z.
/// @param values  at least one, finite; a constant sample: that constant
[[nodiscard]] double limit_of_mean(std::span<const double> values);

}  // namespace haarlight::relight
