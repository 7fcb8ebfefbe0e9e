// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/normal_unevenness.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

constexpr double kDegrees = 180.0 / std::numbers::pi;
/// Variance of a pixel against the mean of two others, all equally uncertain: 1 + 1/2 of one's.
constexpr double kExpected = 1.5;

bool is_good(const SurfaceEstimate& surface, int y, int x) {
  return y >= 0 && y < surface.state.height() && x >= 0 && x < surface.state.width() &&
         surface.state(y, x) == static_cast<std::uint8_t>(PixelState::good);
}

Vector3d normal_at(const SurfaceEstimate& surface, int y, int x) {
  return {double{surface.normal(y, x, 0)}, double{surface.normal(y, x, 1)},
          double{surface.normal(y, x, 2)}};
}

/// Mean square of the angles, degrees^2.
double unevenness(const SurfaceEstimate& surface, int y, int x) {
  const Vector3d n = normal_at(surface, y, x);
  double sum = 0.0;
  int pairs = 0;
  for (int axis = 0; axis < 2; ++axis) {
    const int dy = axis;
    const int dx = 1 - axis;
    if (is_good(surface, y - dy, x - dx) && is_good(surface, y + dy, x + dx)) {
      const Vector3d middle =
          normal_at(surface, y - dy, x - dx) + normal_at(surface, y + dy, x + dx);
      const double angle = std::atan2(n.cross(middle).norm(), n.dot(middle)) * kDegrees;
      sum += angle * angle;
      ++pairs;
    }
  }
  return sum / std::max(1, pairs);
}

}  // namespace

void add_unevenness(SurfaceEstimate& surface) {
  HAARLIGHT_EXPECTS(surface.sigma_deg.height() == surface.state.height() &&
                        surface.sigma_deg.width() == surface.state.width(),
                    "a surface with standard errors");
  for (int y = 0; y < surface.state.height(); ++y) {
    for (int x = 0; x < surface.state.width(); ++x) {
      if (is_good(surface, y, x)) {
        const auto sigma = double{surface.sigma_deg(y, x)};
        const double square = sigma * sigma;
        const double beyond = std::max(0.0, unevenness(surface, y, x) - kExpected * square);
        surface.sigma_deg(y, x) =
            static_cast<float>(std::min(90.0, std::sqrt(square + beyond)));
      }
    }
  }
}

}  // namespace haarlight::relight
