// SPDX-License-Identifier: Apache-2.0
#include "render/film/filter.h"

#include <algorithm>
#include <cmath>

namespace haarlight::render {

namespace {

constexpr int kCells = 1024;
constexpr double kGaussianRadius = 1.5;
constexpr double kGaussianDeviation = 0.5;

double radius_of(FilterKind kind) {
  switch (kind) {
    case FilterKind::box:
      return 0.5;
    case FilterKind::gaussian:
      return kGaussianRadius;
    case FilterKind::mitchell:
      return 2.0;
  }
  return 0.5;
}

double gaussian(double x) {
  return std::exp(-0.5 * (x * x) / (kGaussianDeviation * kGaussianDeviation));
}

/// Simpson's rule from values at a cell's ends and middle: to 1e-12 of these smooth pieces.
double simpson(double width, double a, double middle, double b) {
  return width / 6.0 * (a + 4.0 * middle + b);
}

}  // namespace

double filter_value(FilterKind kind, double x) {
  const double r = std::abs(x);
  switch (kind) {
    case FilterKind::box:
      return r <= 0.5 ? 1.0 : 0.0;
    case FilterKind::gaussian:
      return r < kGaussianRadius ? gaussian(r) - gaussian(kGaussianRadius) : 0.0;
    case FilterKind::mitchell:
      // [Mitchell88], eq. (8) with B = C = 1/3.
      if (r < 1.0) {
        return (7.0 * r * r * r - 12.0 * r * r + 16.0 / 3.0) / 6.0;
      }
      return r < 2.0 ? (-7.0 / 3.0 * r * r * r + 12.0 * r * r - 20.0 * r + 32.0 / 3.0) / 6.0
                     : 0.0;
  }
  return 0.0;
}

PixelFilter::PixelFilter(FilterKind kind) : kind_(kind), radius_(radius_of(kind)) {
  if (kind == FilterKind::box) {
    return;
  }
  integral_ = 0.0;
  double sum = 0.0;
  const double width = 2.0 * radius_ / kCells;
  for (int i = 0; i < kCells; ++i) {
    const double a = -radius_ + width * i;
    const std::array<double, 3> f{filter_value(kind, a), filter_value(kind, a + 0.5 * width),
                                  filter_value(kind, a + width)};
    integral_ += simpson(width, f[0], f[1], f[2]);
    // Where the filter changes its sign the density is not 0.
    sum += simpson(width, std::abs(f[0]), std::abs(f[1]), std::abs(f[2]));
    up_to_.push_back(sum);
  }
  for (double& value : up_to_) {
    value /= sum;
  }
}

PixelFilter::Along PixelFilter::along(double number) const {
  const auto found = std::upper_bound(up_to_.begin(), up_to_.end(), number);
  const auto cell = std::min<std::ptrdiff_t>(found - up_to_.begin(), kCells - 1);
  const double from = cell == 0 ? 0.0 : up_to_[static_cast<std::size_t>(cell) - 1];
  const double part = up_to_[static_cast<std::size_t>(cell)] - from;
  const double width = 2.0 * radius_ / kCells;
  const double x = -radius_ + width * (static_cast<double>(cell) +
                                       std::clamp((number - from) / part, 0.0, 1.0));
  // Filter over density: the density is even within a cell.
  return {.offset = x, .weight = filter_value(kind_, x) / integral_ / (part / width)};
}

PixelFilter::Sample PixelFilter::sample(const Eigen::Vector2d& square) const {
  if (kind_ == FilterKind::box) {
    return {.offset = square.array() - 0.5, .weight = 1.0};
  }
  const Along x = along(square.x());
  const Along y = along(square.y());
  return {.offset = {x.offset, y.offset}, .weight = x.weight * y.weight};
}

}  // namespace haarlight::render
