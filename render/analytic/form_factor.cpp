// SPDX-License-Identifier: Apache-2.0
#include "render/analytic/form_factor.h"

#include <cmath>
#include <numbers>

namespace haarlight::render {

namespace {

// Terms that nearly cancel: 64 bits of mantissa keep the digits that are said.
using Long = long double;
constexpr Long kPi = std::numbers::pi_v<long double>;

/// x^2 ln(x^2 (1 + x^2 + y^2)/((1 + x^2)(x^2 + y^2)))
Long powered(Long x2, Long y2) { return x2 * std::log1p(-y2 / ((1 + x2) * (x2 + y2))); }

}  // namespace

double form_factor_parallel(double a, double b, double gap) {
  const Long x = Long{a} / gap;
  const Long y = Long{b} / gap;
  const Long of_x = std::sqrt(1 + x * x);
  const Long of_y = std::sqrt(1 + y * y);
  // (1 + x^2)(1 + y^2)/(1 + x^2 + y^2) = 1 + x^2 y^2/(1 + x^2 + y^2)
  const Long sum = 0.5L * std::log1p(x * x * y * y / (1 + x * x + y * y)) +
                   x * of_y * std::atan(x / of_y) + y * of_x * std::atan(y / of_x) -
                   x * std::atan(x) - y * std::atan(y);
  return static_cast<double>(2 * sum / (kPi * x * y));
}

double form_factor_perpendicular(double edge, double from, double to) {
  const Long w = Long{from} / edge;
  const Long h = Long{to} / edge;
  const Long w2 = w * w;
  const Long h2 = h * h;
  const Long diagonal = std::sqrt(w2 + h2);
  const Long logs = std::log1p(w2 * h2 / (1 + w2 + h2)) + powered(w2, h2) + powered(h2, w2);
  const Long sum = w * std::atan(1 / w) + h * std::atan(1 / h) -
                   diagonal * std::atan(1 / diagonal) + 0.25L * logs;
  return static_cast<double>(sum / (kPi * w));
}

double form_factor_coaxial_disks(double r1, double r2, double gap) {
  const Long x = Long{r1} / gap;
  const Long y = Long{r2} / gap;
  const Long s = 1 + (1 + y * y) / (x * x);
  const Long ratio = y / x;
  // 1/2 (s - sqrt(s^2 - 4 ratio^2)), without the difference
  return static_cast<double>(2 * ratio * ratio /
                             (s + std::sqrt((s - 2 * ratio) * (s + 2 * ratio))));
}

}  // namespace haarlight::render
