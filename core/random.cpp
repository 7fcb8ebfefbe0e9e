// SPDX-License-Identifier: Apache-2.0
#include "core/random.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace haarlight {

double standard_normal(std::uint64_t hash) {
  // Box-Muller: sqrt(-2 ln u) cos(2 pi v), u in (0, 1] from the high word, v from the low word.
  const double u = (static_cast<double>(hash >> 32) + 1.0) * 0x1p-32;
  const double v = static_cast<double>(hash & 0xffffffffULL) * 0x1p-32;
  return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
}

std::uint32_t poisson(double mean, std::uint64_t hash) {
  if (!(mean > 0.0)) {
    return 0;
  }
  if (mean >= 30.0) {
    const double value = mean + std::sqrt(mean) * standard_normal(hash);
    return static_cast<std::uint32_t>(std::clamp(value + 0.5, 0.0, 4294967295.0));
  }
  const double u = uniform_unit(hash);
  double term = std::exp(-mean);
  double sum = term;
  std::uint32_t count = 0;
  while (u >= sum && count < 200) {  // P(count >= 200 | mean < 30) < 1e-90
    ++count;
    term *= mean / count;
    sum += term;
  }
  return count;
}

}  // namespace haarlight
