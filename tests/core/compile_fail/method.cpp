// SPDX-License-Identifier: Apache-2.0
/// @file
/// Compiles as it stands, but not without a truth (NO_TRUTH) or an error (NO_ERROR).

#include "core/method.h"

struct Input {
  using Result = double;
  explicit Input(haarlight::MethodSize /*size*/) {}
  Result run(std::size_t /*setting*/) { return 1.0; }
#ifndef NO_TRUTH
  Result truth() { return 1.0; }
#endif
#ifndef NO_ERROR
  double error(const Result& found, const Result& truth) { return found - truth; }
#endif
  [[nodiscard]] haarlight::MethodScale scale() const { return {}; }
};

haarlight::Method method() { return haarlight::Method::of<Input>({}); }
