// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/shadow_lookup.h"

#include <algorithm>
#include <cmath>

#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"

namespace haarlight::relight {
namespace {

constexpr double kOnPlaneTexels = 0.01;  // closer than this to the plane counts as on it
constexpr double kMaxFraction = 0.999;   // of the light's height: largest object height

/// The plane as its own picture sees it: x and y are columns and rows, z the height over it.
const Plane kPicturePlane{};

Eigen::Vector3d in_picture(const PlaneSpot& spot) { return {spot.x, spot.y, spot.height}; }

/// Eq. (4); none where the ray does not meet the plane.
std::optional<PlaneStep> ray_step(double light_height, double vertex_height) {
  const PlaneStep at = step_to_plane(light_height, vertex_height, light_height - vertex_height);
  return is_valid(at.status) && std::isfinite(at.step) ? std::optional(at) : std::nullopt;
}

/// A light's projection in the picture.
struct Window {
  double step = 0.0;
  double x = 0.0;  ///< of the light's centre
  double y = 0.0;
};

WindowMean mean_round(const WindowSums& sums, double x, double y, double half_x,
                      double half_y) {
  // Never smaller than a pixel: the mean over one pixel's square is bilinear interpolation.
  const double hx = std::max(half_x, 0.5);
  const double hy = std::max(half_y, 0.5);
  return sums.mean(x - hx, x + hx, y - hy, y + hy);
}

WindowMean mean_over(const PlaneLight& light, const WindowSums& sums, const PlaneSpot& vertex,
                     const Window& at, double scale) {
  if (light.is_upright) {
    const double size = std::abs(at.step) * scale;
    return mean_round(sums, at.x, at.y, size * light.half_x, size * light.half_y);
  }
  std::array<Eigen::Vector3d, 4> corners;
  std::transform(light.corners.begin(), light.corners.end(), corners.begin(), in_picture);
  const LightWindow window =
      project_window(kPicturePlane, in_picture(light.centre), corners, in_picture(vertex));
  if (!window.has_corners) {
    return mean_round(sums, at.x, at.y, 0.0, 0.0);  // part of the light is below the plane
  }
  std::array<Eigen::Vector2d, 4> quad;
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  const Eigen::Vector2d c(at.x, at.y);
  for (std::size_t i = 0; i < 4; ++i) {
    quad[i] = c + scale * (window.corners[i].head<2>() - c);
    low = low.cwiseMin(quad[i]);
    high = high.cwiseMax(quad[i]);
  }
  if ((high - low).maxCoeff() <= 1.0) {
    const Eigen::Vector2d middle = 0.5 * (low + high);
    return mean_round(sums, middle.x(), middle.y(), 0.0, 0.0);
  }
  return sums.mean(quad);
}

}  // namespace

PlaneSpot locate_point(const PlaneFrame& frame, const Eigen::Vector3d& world) {
  const Eigen::Vector2d at = frame.picture_of(world);
  return {frame.height_of(world), at.x(), at.y()};
}

PlaneLight place_light(const PlaneFrame& frame, const render::SquareLight& light) {
  PlaneLight placed;
  placed.centre = locate_point(frame, light.centre);
  const std::array<Eigen::Vector3d, 4> corners = render::light_corners(light);
  const double tolerance = 1e-9 * (1.0 + std::abs(placed.centre.height) + light.width_mm);
  placed.is_upright = true;
  for (std::size_t i = 0; i < 4; ++i) {
    placed.corners[i] = locate_point(frame, corners[i]);
    placed.half_x = std::max(placed.half_x, std::abs(placed.corners[i].x - placed.centre.x));
    placed.half_y = std::max(placed.half_y, std::abs(placed.corners[i].y - placed.centre.y));
  }
  for (const PlaneSpot& corner : placed.corners) {
    placed.is_upright = placed.is_upright &&
                        std::abs(corner.height - placed.centre.height) <= tolerance &&
                        placed.half_x - std::abs(corner.x - placed.centre.x) <= tolerance &&
                        placed.half_y - std::abs(corner.y - placed.centre.y) <= tolerance;
  }
  return placed;
}

ShadowLook look_up(const PlaneFrame& frame, const std::optional<HeightRange>& object,
                   LookRule rule, const PlaneLight& light, const WindowSums& sums,
                   const PlaneSpot& vertex) {
  ShadowLook look;
  const double a = light.centre.height;
  const std::optional<PlaneStep> step = ray_step(a, vertex.height);
  if (!step) {
    return look;
  }
  const double over = a > 0.0 ? vertex.height : -vertex.height;  // mm on the light's side
  const bool is_on = std::abs(over) < kOnPlaneTexels * frame.texel_mm;
  look.side = is_on ? PlaneSide::on : over > 0.0 ? PlaneSide::above : PlaneSide::below;
  look.step = step->step;
  if (object && over >= object->high_mm) {
    return look;  // no part of the object is between this point and the light
  }
  const double H = std::abs(a);
  const double ratio = step->ratio;
  const Window at{step->step, step->meet(light.centre.x, vertex.x),
                  step->meet(light.centre.y, vertex.y)};
  const bool is_below = look.side == PlaneSide::below;
  const bool is_windowed = !is_on && (rule.window == WindowRule::plain || rule.is_block ||
                                      (is_below && rule.window == WindowRule::corrected));
  WindowMean mean;
  if (!is_windowed) {
    mean = mean_round(sums, at.x, at.y, 0.0, 0.0);
  } else if (is_below && object && rule.window != WindowRule::plain) {
    // A height range has a window at each end.
    const auto mean_at = [&](double height) {
      const double fraction = std::min(height / H, kMaxFraction);
      return mean_over(light, sums, vertex, at,
                       fraction > 0.0 ? corrected_window_scale(ratio, fraction) : 1.0);
    };
    mean = mean_at(std::max(0.0, object->low_mm));
    if (object->high_mm > std::max(0.0, object->low_mm)) {
      const WindowMean high = mean_at(object->high_mm);
      look.lower = 0.5 * std::abs(high.value - mean.value);
      mean = {0.5 * (mean.value + high.value), std::max(mean.unknown, high.unknown),
              0.5 * (mean.outside + high.outside)};
    }
  } else {
    mean = mean_over(light, sums, vertex, at, 1.0);
  }
  if (object && look.side == PlaneSide::above && mean.value < 1.0) {
    look.widening = widening_above(ratio, std::min(object->high_mm / H, kMaxFraction));
  }
  look.value = mean.value;
  look.unknown = mean.unknown;
  look.outside = mean.outside;
  look.lower += 0.5 * mean.unknown;
  look.upper = look.lower;
  const double measured = 1.0 - mean.unknown - mean.outside;
  look.deviation = mean.value < 1.0 ? measured * sums.deviation() : 0.0;
  return look;
}

ShadowLook combine(std::span<const ShadowLook> looks) {
  if (looks.size() == 1) {
    return looks[0];
  }
  const ShadowLook* behind = nullptr;  // seen from the light: step >= 0
  const ShadowLook* before = nullptr;
  const ShadowLook* missed = nullptr;
  for (const ShadowLook& look : looks) {
    if (look.side == PlaneSide::no_point) {
      continue;
    }
    if (look.outside >= 1.0) {
      missed = &look;
      continue;
    }
    const ShadowLook*& nearest = look.step >= 0.0 ? behind : before;
    if (nearest == nullptr || std::abs(look.step) < std::abs(nearest->step)) {
      nearest = &look;
    }
  }
  if (behind == nullptr || before == nullptr) {
    const ShadowLook* one = behind != nullptr ? behind : before != nullptr ? before : missed;
    return one != nullptr ? *one : ShadowLook{};
  }
  const double reach = behind->step - before->step;
  const double fraction = reach > 0.0 ? -before->step / reach : 1.0;  // of `behind`
  ShadowLook look = fraction >= 0.5 ? *behind : *before;
  for (double ShadowLook::*part :
       {&ShadowLook::value, &ShadowLook::lower, &ShadowLook::upper, &ShadowLook::deviation,
        &ShadowLook::unknown, &ShadowLook::outside}) {
    look.*part = fraction * behind->*part + (1.0 - fraction) * before->*part;
  }
  return look;
}

bool is_all_lit(const PlaneFrame& frame, const std::optional<HeightRange>& object,
                WindowRule rule, const PlaneLight& centres, const PlaneLight& light,
                const WindowSums& sums, const PlaneSpot& vertex) {
  if (!centres.is_upright || !light.is_upright) {
    return false;
  }
  const std::optional<PlaneStep> step = ray_step(centres.centre.height, vertex.height);
  if (!step) {
    return false;
  }
  const double size = std::abs(step->step);
  double scale = rule == WindowRule::none ? 0.0 : 1.0;
  const double over = centres.centre.height > 0.0 ? vertex.height : -vertex.height;
  if (rule == WindowRule::corrected && object && over < -kOnPlaneTexels * frame.texel_mm) {
    const double fraction =
        std::clamp(object->high_mm / std::abs(centres.centre.height), 0.0, kMaxFraction);
    scale = corrected_window_scale(step->ratio, fraction);
  }
  const double x = step->meet(centres.centre.x, vertex.x);
  const double y = step->meet(centres.centre.y, vertex.y);
  const double hx = size * centres.half_x + std::max(0.5, scale * size * light.half_x);
  const double hy = size * centres.half_y + std::max(0.5, scale * size * light.half_y);
  // Beyond the picture everything is lit too, but must be counted.
  const bool is_inside =
      x - hx >= 0.0 && y - hy >= 0.0 && x + hx <= frame.width && y + hy <= frame.height;
  return is_inside && sums.is_lit(x - hx, x + hx, y - hy, y + hy);
}

}  // namespace haarlight::relight
