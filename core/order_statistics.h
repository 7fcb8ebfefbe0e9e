// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "haarlight/core/error.h"

/// @file
/// Medians and quantiles, O(n). Of a vector they take a copy; of a span they reorder the values
/// in place, for loops over pixels and for threads that may not allocate.

namespace haarlight {

/// sigma / median |x - m| of a normal distribution: 1 / Phi^-1(3/4).
inline constexpr double kSigmaPerMad = 1.4826;

/// The value at `rank` (from 0) of the sorted values. Reorders.
/// @throws ContractViolation  unless rank < n
template <class T>
[[nodiscard]] T value_of_rank(std::span<T> reordered, std::size_t rank) {
  HAARLIGHT_EXPECTS(rank < reordered.size(), "a rank among the values");
  const auto at = reordered.begin() + static_cast<std::ptrdiff_t>(rank);
  std::nth_element(reordered.begin(), at, reordered.end());
  return *at;
}

/// The value of rank floor(q (n - 1)): one of the values, never interpolated. Reorders.
/// @param q  0..1; 0 is the least value, 1 the greatest
/// @throws ContractViolation  where there is no value
template <class T>
[[nodiscard]] T quantile(std::span<T> reordered, double q) {
  HAARLIGHT_EXPECTS(q >= 0.0 && q <= 1.0, "a fraction of the values");
  HAARLIGHT_EXPECTS(!reordered.empty(), "values to take a quantile of");
  return value_of_rank(reordered,
                       static_cast<std::size_t>(q * static_cast<double>(reordered.size() - 1)));
}
template <class T>
[[nodiscard]] T quantile(std::vector<T> values, double q) {
  return quantile(std::span(values), q);
}

/// The value of rank n / 2: for even n the greater of the two in the middle. Reorders.
/// @throws ContractViolation  where there is no value
template <class T>
[[nodiscard]] T upper_median(std::span<T> reordered) {
  return value_of_rank(reordered, reordered.size() / 2);
}
template <class T>
[[nodiscard]] T upper_median(std::vector<T> values) {
  return upper_median(std::span(values));
}

/// The median: for even n the mean of the two in the middle. Reorders.
/// @throws ContractViolation  where there is no value
[[nodiscard]] inline double median(std::span<double> reordered) {
  const double upper = upper_median(reordered);
  const std::span<double> lower = reordered.first(reordered.size() / 2);
  return reordered.size() % 2 == 1
             ? upper
             : 0.5 * (*std::max_element(lower.begin(), lower.end()) + upper);
}
[[nodiscard]] inline double median(std::vector<double> values) {
  return median(std::span(values));
}

}  // namespace haarlight
