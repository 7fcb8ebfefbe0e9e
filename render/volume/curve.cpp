// SPDX-License-Identifier: Apache-2.0
#include "render/volume/curve.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace haarlight::render {

namespace {

constexpr std::size_t kLast = Curve::kPoints - 1;
/// Of the largest value: coefficients below it are rounding.
constexpr double kNoise = 4e-16;

using Values = std::array<double, Curve::kPoints>;

Values cosines() {
  Values x{};
  for (std::size_t i = 0; i <= kLast; ++i) {
    // By the sine: exactly odd about the middle.
    x.at(i) =
        std::sin(std::numbers::pi * (2.0 * static_cast<double>(i) - kLast) / (2.0 * kLast));
  }
  return x;
}

}  // namespace

const Values& Curve::points() {
  static const Values kAt = [] {
    Values s = cosines();
    for (double& x : s) {
      x = 0.5 * (1.0 + x);
    }
    return s;
  }();
  return kAt;
}

Curve Curve::linear(double at_0, double at_1) {
  Curve curve;
  curve.c_[0] = 0.5 * at_0 + 0.5 * at_1;
  curve.c_[1] = 0.5 * at_1 - 0.5 * at_0;
  curve.degree_ = 1;
  return curve;
}

Curve Curve::quadratic(double at_0, double at_half, double at_1) {
  Curve curve;
  curve.c_[2] = 0.25 * (at_0 + at_1) - 0.5 * at_half;
  curve.c_[1] = 0.5 * at_1 - 0.5 * at_0;
  curve.c_[0] = at_half + curve.c_[2];
  curve.degree_ = 2;
  const double largest = std::max({std::abs(at_0), std::abs(at_half), std::abs(at_1)});
  return std::abs(curve.c_[2]) > kNoise * largest ? curve : linear(at_0, at_1);
}

Curve Curve::through(const Values& values, double noise) {
  static const std::array<Values, kPoints> kCosines = [] {
    std::array<Values, kPoints> table{};
    for (std::size_t k = 0; k <= kLast; ++k) {
      for (std::size_t i = 0; i <= kLast; ++i) {
        const double ends =
            (i == 0 || i == kLast ? 0.5 : 1.0) * (k == 0 || k == kLast ? 0.5 : 1.0);
        table.at(k).at(i) =
            ends * 2.0 / kLast *
            std::cos(std::numbers::pi * static_cast<double>(k * (kLast - i) % (2 * kLast)) /
                     kLast);
      }
    }
    return table;
  }();
  Curve curve;
  for (std::size_t k = 0; k <= kLast; ++k) {
    for (std::size_t i = 0; i <= kLast; ++i) {
      curve.c_.at(k) += kCosines.at(k).at(i) * values.at(i);
    }
  }
  curve.noise_ = noise;
  curve.tail_ = std::max(std::abs(curve.c_[kLast]), std::abs(curve.c_[kLast - 1]));
  curve.degree_ = kLast;
  while (curve.degree_ > 1 && std::abs(curve.c_.at(curve.degree_)) <= noise) {
    --curve.degree_;
  }
  return curve;
}

double Curve::operator()(double s) const {
  const double x = 2.0 * s - 1.0;
  double next = 0.0;  // Clenshaw's recurrence
  double after = 0.0;
  for (std::size_t k = degree_; k > 0; --k) {
    const double b = c_.at(k) + 2.0 * x * next - after;
    after = next;
    next = b;
  }
  return c_[0] + x * next - after;
}

double Curve::slope(double s) const {
  const double x = 2.0 * s - 1.0;
  // T_k' = k U_(k-1)
  double sum = 0.0;
  double u = 1.0;
  double before = 0.0;
  for (std::size_t k = 1; k <= degree_; ++k) {
    sum += static_cast<double>(k) * c_.at(k) * u;
    const double following = 2.0 * x * u - before;
    before = u;
    u = following;
  }
  return 2.0 * sum;
}

void Curve::add_turns(std::vector<double>& splits) const {
  if (degree_ < 2) {
    return;
  }
  if (degree_ == 2) {
    const double x = -0.25 * c_[1] / c_[2];
    if (std::abs(x) < 1.0) {
      splits.push_back(0.5 * (1.0 + x));
    }
    return;
  }
  constexpr int kHalvings = 24;
  add_turns_between(*this, 0.0, 1.0, kHalvings, splits);
}

/// @param part  of it, from `from` to `to`
void Curve::add_turns_between(const Curve& part, double from, double to, int n_halvings,
                              std::vector<double>& splits) const {
  // What its slope, and the slope's slope, may differ from those of its first terms:
  // |T_k'| <= k^2, |T_k''| <= k^2 (k^2 - 1)/3.
  double of_slope = 0.0;
  double of_bend = 0.0;
  for (std::size_t k = 2; k <= part.degree_; ++k) {
    const auto k2 = static_cast<double>(k * k);
    const double size = std::abs(part.c_.at(k));
    of_slope += k2 * size;
    of_bend += k > 2 ? k2 * (k2 - 1.0) / 3.0 * size : 0.0;
  }
  const double noise = std::max(noise_, kNoise * std::abs(part.c_[0]));
  if (std::abs(part.c_[1]) >= of_slope || of_slope <= noise || n_halvings == 0) {
    return;
  }
  constexpr double kBendOfSecond = 4.0;
  if (kBendOfSecond * std::abs(part.c_[2]) >= of_bend) {  // one turn at most
    if ((slope(from) < 0.0) != (slope(to) < 0.0)) {
      splits.push_back(turn_between(from, to));
    }
    return;
  }
  const double middle = 0.5 * (from + to);
  add_turns_between(resampled(from, middle), from, middle, n_halvings - 1, splits);
  splits.push_back(middle);
  add_turns_between(resampled(middle, to), middle, to, n_halvings - 1, splits);
}

Curve Curve::resampled(double from, double to) const {
  Values values{};
  for (std::size_t i = 0; i <= kLast; ++i) {
    values.at(i) = (*this)(from + (to - from) * points().at(i));
  }
  return through(values, 0.0);
}

/// Where the slope changes its sign, which it does once.
double Curve::turn_between(double low, double high) const {
  const bool rises = slope(low) < 0.0;
  constexpr int kHalvings = 53;
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (low + high);
    ((slope(middle) < 0.0) == rises ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

double crossing_of(const Curve& curve, double value, double from, double to) {
  const double sign = curve(to) >= curve(from) ? 1.0 : -1.0;
  double low = from;
  double high = to;
  double s = 0.5 * (from + to);
  constexpr int kMostSteps = 100;
  for (int step = 0; step < kMostSteps; ++step) {
    const double off = sign * (curve(s) - value);
    if (off == 0.0) {
      return s;
    }
    (off < 0.0 ? low : high) = s;
    const double slope = sign * curve.slope(s);
    double next = s - off / slope;  // Newton's, or halving where that leaves the bracket
    if (!(next > low && next < high)) {
      next = 0.5 * (low + high);
    }
    if (std::abs(next - s) <= std::numeric_limits<double>::epsilon() * std::abs(s)) {
      return next;
    }
    s = next;
  }
  return s;
}

}  // namespace haarlight::render
