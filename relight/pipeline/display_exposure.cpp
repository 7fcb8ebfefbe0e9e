// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/display_exposure.h"

#include <algorithm>
#include <cstddef>

namespace haarlight::relight {

double display_exposure(std::vector<float> values, double fraction) {
  if (values.empty()) {
    return 1.0;
  }
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(
                                       fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at > 0.0F ? 1.0 / static_cast<double>(*at) : 1.0;
}

}  // namespace haarlight::relight
