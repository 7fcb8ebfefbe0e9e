// SPDX-License-Identifier: Apache-2.0
#include "core/method.h"

#include <algorithm>
#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight {

double relative_l2(std::span<const double> found, std::span<const double> truth) {
  HAARLIGHT_EXPECTS(found.size() == truth.size(), "a number for each of the truth's");
  double square = 0.0;
  double norm = 0.0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    square += std::pow(found[i] - truth[i], 2);
    norm += std::pow(truth[i], 2);
  }
  return std::sqrt(square / norm);
}

Method::Method(MethodWords words, Prepare prepare)
    : words_(std::move(words)), prepare_(std::move(prepare)) {
  HAARLIGHT_EXPECTS(!words_.module.empty() && !words_.name.empty(),
                    "a method has a module and a name");
  HAARLIGHT_EXPECTS(!words_.error_norm.empty(), "a method says how its error is measured");
  HAARLIGHT_EXPECTS(!words_.truth.empty(), "a method says what its results are compared with");
  HAARLIGHT_EXPECTS(words_.exact_error >= 0.0 && !words_.exact_error_from.empty(),
                    "a method says how far off its exact setting may be, and why");
  HAARLIGHT_EXPECTS(words_.settings.size() >= 2, "a method has two settings or more");
  std::vector<std::string> sorted = words_.settings;
  std::sort(sorted.begin(), sorted.end());
  HAARLIGHT_EXPECTS(!sorted.front().empty() &&
                        std::adjacent_find(sorted.begin(), sorted.end()) == sorted.end(),
                    "each setting has words of its own");
}

}  // namespace haarlight
