// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/tolerance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/order_statistics.h"

namespace haarlight {

Achieved compare(std::span<const float> result, std::span<const float> reference) {
  HAARLIGHT_EXPECTS(result.size() == reference.size(), "pictures of equal size");
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  double error_energy = 0.0;
  double reference_energy = 0.0;
  double worst = 0.0;
  double peak = 0.0;
  for (std::size_t i = 0; i < result.size(); ++i) {
    const double r = reference[i];
    const double e = static_cast<double>(result[i]) - r;
    error_energy += e * e;
    reference_energy += r * r;
    worst = std::max(worst, std::abs(e));
    peak = std::max(peak, std::abs(r));
  }
  Achieved achieved;
  if (error_energy == 0.0) {
    achieved.psnr_db = kInfinity;
    return achieved;
  }
  achieved.relative_l2 =
      reference_energy > 0.0 ? std::sqrt(error_energy / reference_energy) : kInfinity;
  achieved.worst_pixel = peak > 0.0 ? worst / peak : kInfinity;
  std::vector<float> sorted(reference.begin(), reference.end());
  const double rms = std::sqrt(error_energy / static_cast<double>(result.size()));
  achieved.psnr_db = 20.0 * std::log10(static_cast<double>(quantile(sorted, 0.999)) / rms);
  return achieved;
}

}  // namespace haarlight
