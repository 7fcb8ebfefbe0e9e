// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/sample_limit.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace haarlight::relight {

namespace {

constexpr double kStandardErrors = 3.0;  // of a symmetric distribution

}  // namespace

double limit_of_mean(std::span<const double> values) {
  const double z = kStandardErrors;
  const auto n = static_cast<double>(values.size());
  const double mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  double second = 0.0;
  double third = 0.0;
  for (const double value : values) {
    const double off = value - mean;
    second += off * off / n;
    third += off * off * off / n;
  }
  if (!(second > 0.0)) {
    return mean;
  }
  const double g = std::max(0.0, third / (second * std::sqrt(second * n)));
  const double errors = z + g * (1.0 + 2.0 * z * z) / 6.0 + g * g * (z + 2.0 * z * z * z) / 9.0;
  return mean + errors * std::sqrt(second / n);
}

}  // namespace haarlight::relight
