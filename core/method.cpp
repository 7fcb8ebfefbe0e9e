// SPDX-License-Identifier: Apache-2.0
#include "core/method.h"

#include <algorithm>

#include "haarlight/core/error.h"

namespace haarlight {

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
