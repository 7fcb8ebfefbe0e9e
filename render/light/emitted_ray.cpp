// SPDX-License-Identifier: Apache-2.0
#include "render/light/emitted_ray.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <type_traits>
#include <variant>

#include "render/bsdf/shading_frame.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;

/// A direction about a normal, of that cosine.
Vector3d around(const Vector3d& normal, double cosine, double turns) {
  const double sine = std::sqrt(std::max(0.0, (1.0 - cosine) * (1.0 + cosine)));
  const Vector2d side = sine * at_turns(turns);
  return frame_of(normal) * Vector3d(side.x(), side.y(), cosine);
}

/// The exponent of the cosine by which the light's intensity falls: Lambert's law is 1.
template <class Kind>
double lobe_of(const Kind& light) {
  if constexpr (std::is_same_v<Kind, LedLight>) {
    return light.square.lobe_mu;
  } else {
    return 1.0;
  }
}

/// (mu + 1)/(2 pi) cos^mu
double lobe_density(double mu, double cosine) {
  return cosine > 0.0 ? (mu + 1.0) / (2.0 * kPi) * std::pow(cosine, mu) : 0.0;
}

/// From a point of a surface, by its lobe.
template <class Kind>
EmittedRay emit_from(const Kind& light, const AreaPoint& at, const Vector2d& square) {
  const double mu = lobe_of(light);
  const double cosine = std::pow(1.0 - square.x(), 1.0 / (mu + 1.0));
  return {.origin = at.point,
          .direction = around(at.normal, cosine, square.y()),
          .normal = at.normal,
          .cosine = cosine,
          .radiance = light.radiance(cosine),
          .position_density = at.density_per_mm2,
          .direction_density = lobe_density(mu, cosine)};
}

/// How much of its intensity a spot has in a direction of that cosine to its axis.
double spot_part(const PointLight& light, double cosine) {
  if (cosine < light.cos_end) {
    return 0.0;
  }
  if (cosine >= light.cos_full) {
    return 1.0;
  }
  const double t = (cosine - light.cos_end) / (light.cos_full - light.cos_end);
  return t * t * (3.0 - 2.0 * t);
}

/// Solid angle that shines with its full intensity would shine as much.
double spot_angle(const PointLight& light) {
  return 2.0 * kPi * (1.0 - 0.5 * (light.cos_full + light.cos_end));
}

/// t of 2 t^3 - t^4 = u, the integral of the smooth step from 0 to t over that to 1. It is convex:
/// from above Newton's method comes down to the root.
double smooth_step_quantile(double u) {
  double t = std::cbrt(u);
  for (int i = 0; i < 64; ++i) {
    const double slope = t * t * (6.0 - 4.0 * t);
    const double next = slope > 0.0 ? t - (t * t * t * (2.0 - t) - u) / slope : 0.0;
    if (!(next < t)) {
      break;
    }
    t = std::max(0.0, next);
  }
  return t;
}

/// A point of the disk of the scene's radius, twice as far before its middle.
Vector3d before_the_scene(const Vector3d& middle, double radius, const Vector3d& direction,
                          const Vector2d& square) {
  const Vector2d at = radius * concentric_disk(square);
  return middle - 2.0 * radius * direction +
         frame_of(direction).leftCols<2>() * Vector2d(at.x(), at.y());
}

EmittedRay emitted(const SphereLight& light, const Vector3d& /*middle*/,
                   const Vector2d& position, const Vector2d& direction) {
  const double height = 1.0 - 2.0 * position.x();
  const double width = 2.0 * std::sqrt(position.x() * (1.0 - position.x()));
  const Vector2d side = width * at_turns(position.y());
  const Vector3d normal(side.x(), side.y(), height);
  const double radius = light.sphere.radius_mm;
  const double cosine = std::sqrt(1.0 - direction.x());
  return {.origin = light.sphere.centre + radius * normal,
          .direction = around(normal, cosine, direction.y()),
          .normal = normal,
          .cosine = cosine,
          .radiance = light.radiance,
          .position_density = 1.0 / (4.0 * kPi * radius * radius),
          .direction_density = lobe_density(1.0, cosine)};
}

EmittedRay emitted(const PointSource& source, const Vector3d& /*middle*/,
                   const Vector2d& /*position*/, const Vector2d& direction) {
  const PointLight& light = source.light;
  // The cosine falls from the axis: first through the full part, then through the part that fades.
  const double full = 1.0 - light.cos_full;
  const double fading = 0.5 * (light.cos_full - light.cos_end);
  const double up_to = direction.x() * (full + fading);
  const double cosine = up_to < full || fading == 0.0
                            ? 1.0 - up_to
                            : light.cos_end + 2.0 * fading *
                                                  smooth_step_quantile(std::clamp(
                                                      1.0 - (up_to - full) / fading, 0.0, 1.0));
  const double part = spot_part(light, cosine);
  return {.origin = light.position,
          .direction = around(light.axis, cosine, direction.y()),
          .radiance = part * light.intensity,
          .direction_density = part / spot_angle(light),
          .has_one_position = true};
}

EmittedRay emitted(const DirectionalSource& source, const Vector3d& middle,
                   const Vector2d& position, const Vector2d& /*direction*/) {
  const double radius = source.scene_radius_mm;
  const Vector3d& direction = source.light.direction;
  return {.origin = before_the_scene(middle, radius, direction, position),
          .direction = direction,
          .normal = direction,
          .radiance = source.light.irradiance,
          .position_density = 1.0 / (kPi * radius * radius),
          .has_one_direction = true,
          .is_far = true};
}

EmittedRay emitted(const EnvironmentSourceLight& source, const Vector3d& middle,
                   const Vector2d& position, const Vector2d& direction) {
  const double radius = source.scene_radius_mm;
  const EnvironmentDirection drawn = source.light.sample(direction);
  return {.origin = before_the_scene(middle, radius, -drawn.direction, position),
          .direction = -drawn.direction,
          .normal = -drawn.direction,
          .radiance = drawn.radiance,
          .position_density = 1.0 / (kPi * radius * radius),
          .direction_density = drawn.density,
          .is_far = true};
}

/// Of a light that is drawn by area.
template <class Kind>
EmittedRay emitted(const Kind& light, const Vector3d& /*middle*/, const Vector2d& position,
                   const Vector2d& direction) {
  return emit_from(light, light.draw(position), direction);
}

double area_mm2(const MeshLight& light) { return light.area_mm2(); }
double area_mm2(const SphereLight& light) {
  return 4.0 * kPi * light.sphere.radius_mm * light.sphere.radius_mm;
}
double area_mm2(const DiskLight& light) {
  return kPi * light.disk.radius_mm * light.disk.radius_mm;
}
double area_mm2(const LedLight& light) {
  return light.square.width_mm * light.square.height_mm;
}

template <class Kind>
EmissionDensity density_of(const Kind& light, double cosine, const Vector3d& direction) {
  if constexpr (std::is_same_v<Kind, PointSource>) {
    return {.position = 1.0,
            .direction = spot_part(light.light, light.light.axis.dot(direction)) /
                         spot_angle(light.light)};
  } else if constexpr (std::is_same_v<Kind, DirectionalSource>) {
    return {.position = 1.0 / (kPi * light.scene_radius_mm * light.scene_radius_mm),
            .direction = direction == light.light.direction ? 1.0 : 0.0};
  } else if constexpr (std::is_same_v<Kind, EnvironmentSourceLight>) {
    return {.position = 1.0 / (kPi * light.scene_radius_mm * light.scene_radius_mm),
            .direction = light.light.density(-direction)};
  } else {
    return {.position = 1.0 / area_mm2(light),
            .direction = lobe_density(lobe_of(light), cosine)};
  }
}

}  // namespace

EmittedRay emit(const Light& light, const Vector3d& scene_middle, const Vector2d& position,
                const Vector2d& direction) {
  return std::visit(
      [&](const auto& kind) { return emitted(kind, scene_middle, position, direction); },
      light);
}

EmissionDensity emission_density(const Light& light, double cosine, const Vector3d& direction) {
  return std::visit([&](const auto& kind) { return density_of(kind, cosine, direction); },
                    light);
}

}  // namespace haarlight::render
