// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/plane_offset.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include <Eigen/Cholesky>

#include "core/order_statistics.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kFewest = 16;  // points that can tell a plane from what stands on it

/// Height, and its slopes along u and v.
Eigen::Vector3d fit_closest_half(std::span<PlanePoint> points, Eigen::Vector3d fit) {
  constexpr int kRounds = 50;
  const auto row = [](const PlanePoint& point) {
    return Eigen::Vector3d(1.0, point.position.x(), point.position.y());
  };
  const std::span<PlanePoint> closest = points.first((points.size() + 1) / 2);
  for (int round = 0; round < kRounds; ++round) {
    std::nth_element(points.begin(),
                     points.begin() + static_cast<std::ptrdiff_t>(closest.size()), points.end(),
                     [&](const PlanePoint& a, const PlanePoint& b) {
                       return std::abs(a.height.mm - fit.dot(row(a))) <
                              std::abs(b.height.mm - fit.dot(row(b)));
                     });
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (const PlanePoint& point : closest) {
      normal += row(point) * row(point).transpose();
      right += row(point) * point.height.mm;
    }
    const Eigen::Vector3d next = normal.ldlt().solve(right);
    if (!next.allFinite() || next == fit) {
      break;
    }
    fit = next;
  }
  return fit;
}

}  // namespace

std::optional<SurfaceHeight> height_of_lit(std::span<const float> values,
                                           std::span<const float> plate,
                                           std::span<const double> slopes) {
  constexpr double kMostLights = 0.8;
  constexpr double kFalloffs = 0.3;  // T/B varies by that at an eighth of the lights' height
  std::vector<float> ratios;
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (plate[k] > 0.0F) {
      ratios.push_back(values[k] / plate[k]);
    }
  }
  if (ratios.empty()) {
    return std::nullopt;
  }
  const float albedo = upper_median(std::span(ratios));
  const auto n_lit = std::count_if(ratios.begin(), ratios.end(), [&](float ratio) {
    return std::abs(ratio - albedo) <= kFalloffs * albedo;
  });
  if (!(albedo > 0.0F) ||
      static_cast<double>(n_lit) < kMostLights * static_cast<double>(ratios.size())) {
    return std::nullopt;
  }
  std::vector<float> scaled(plate.begin(), plate.end());
  for (float& value : scaled) {
    value *= albedo;
  }
  const SurfaceHeight found = height_from_falloff(values, scaled, slopes, kFalloffs);
  return std::isfinite(found.error_mm) ? std::optional(found) : std::nullopt;
}

PlaneOffset plane_offset(std::vector<PlanePoint> points, const PlaneFrame& frame,
                         double lights_mm) {
  constexpr double kStandardErrors = 3.0;
  constexpr double kNoticeable = 0.002;
  PlaneOffset offset;
  offset.n_pixels = points.size();
  if (points.size() < kFewest) {
    return offset;
  }
  // Whatever order they come in, the sums are the same.
  std::sort(points.begin(), points.end(), [](const PlanePoint& a, const PlanePoint& b) {
    return std::pair(a.position.x(), a.position.y()) <
           std::pair(b.position.x(), b.position.y());
  });
  std::vector<double> heights;
  std::vector<double> errors;
  for (const PlanePoint& point : points) {
    heights.push_back(point.height.mm);
    errors.push_back(point.height.error_mm);
  }
  const Eigen::Vector3d fit =
      fit_closest_half(points, {upper_median(std::span(heights)), 0.0, 0.0});
  offset.mm = fit[0];
  offset.tilt_deg = std::atan(std::hypot(fit[1], fit[2])) * 180.0 / std::numbers::pi;
  offset.most_mm =
      std::abs(fit[0]) +
      0.5 * frame.texel_mm * (std::abs(fit[1]) * frame.width + std::abs(fit[2]) * frame.height);
  offset.error_mm = upper_median(std::span(errors));
  offset.is_noticeable = offset.most_mm > kStandardErrors * offset.error_mm &&
                         offset.most_mm > kNoticeable * lights_mm;
  return offset;
}

}  // namespace haarlight::relight
