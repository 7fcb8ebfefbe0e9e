// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/sheet_model.h"

#include <algorithm>

namespace haarlight::relight {

bool SheetValues::is_zero() const {
  return std::all_of(of.begin(), of.end(), [](double v) { return v == 0.0; });
}

SheetPriors matte_paper(bool has_view) {
  SheetPriors priors;
  if (has_view) {
    priors.sigma[SheetTerm::roughness] = std::numeric_limits<double>::infinity();
    priors.sigma[SheetTerm::sheen] = 0.1;
  }
  priors.sigma[SheetTerm::bow_xx] = 1.0;
  priors.sigma[SheetTerm::bow_xy] = 1.0;
  priors.sigma[SheetTerm::bow_yy] = 1.0;
  priors.sigma[SheetTerm::lens] = 0.005;
  return priors;
}

double roughness_of_slope(double sigma) {
  const double s2 = sigma * sigma;
  return 0.45 * s2 / (s2 + 0.09) / (1.0 - 0.5 * s2 / (s2 + 0.33));
}

double slope_of_roughness(double q) {
  double low = 0.0;
  double high = 1.5;
  if (!(q > 0.0)) {
    return 0.0;
  }
  for (int i = 0; i < 60; ++i) {
    const double mid = 0.5 * (low + high);
    (roughness_of_slope(mid) < q ? low : high) = mid;
  }
  return 0.5 * (low + high);
}

}  // namespace haarlight::relight
