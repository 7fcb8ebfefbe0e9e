// SPDX-License-Identifier: Apache-2.0
#include "render/light/light.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <type_traits>
#include <utility>

#include <Eigen/Geometry>

#include "render/sampling/warp.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
constexpr double kPi = std::numbers::pi;

/// Of a light that is drawn by area.
template <class Kind>
LightSample area_sample(const Kind& light, const Vector3d& from, const Vector2d& square,
                        bool hides_itself) {
  const AreaPoint drawn = light.draw(square);
  const Vector3d way = drawn.point - from;
  const double towards = -drawn.normal.dot(way);
  if (!(towards > 0.0)) {
    return {};
  }
  const double distance = way.norm();
  const double inverse = 1.0 / distance;
  return {.is_found = true,
          .direction = inverse * way,
          .distance_mm = distance,
          .normal = hides_itself ? drawn.normal : Vector3d::Zero(),
          .radiance = light.radiance(inverse * towards),
          .density = drawn.density_per_mm2 * distance * distance * distance / towards};
}

double area_density(const LightHit& hit, double area_mm2) {
  return hit.cosine > 0.0 ? hit.distance_mm * hit.distance_mm / (hit.cosine * area_mm2) : 0.0;
}

template <class Kind>
concept IsSomewhere = requires(const Kind& light) {
  light.bounds();
};

template <class Kind>
concept IsDrawnByArea = requires(const Kind& light, const Vector2d& square) {
  light.draw(square);
};

template <class Kind>
concept MayBeMet = requires(const Kind& light, const Vector3d& from, const LightHit& hit) {
  light.density(from, hit);
};

}  // namespace

MeshLight::MeshLight(const Mesh& mesh, Vector3d radiance) : radiance_(std::move(radiance)) {
  double sum = 0.0;
  up_to_.reserve(mesh.triangles.size());
  triangles_.reserve(mesh.triangles.size());
  for (const Eigen::Vector3i& triangle : mesh.triangles) {
    const auto corner = [&](int i) -> const Vector3d& {
      return mesh.vertices[static_cast<std::size_t>(triangle[i])];
    };
    const Vector3d to_second = corner(1) - corner(0);
    const Vector3d to_third = corner(2) - corner(0);
    const Vector3d area = to_second.cross(to_third);
    sum += 0.5 * area.norm();
    up_to_.push_back(sum);
    triangles_.push_back({.corner = corner(0),
                          .to_second = to_second,
                          .to_third = to_third,
                          .normal = area.normalized()});
  }
  density_per_mm2_ = 1.0 / sum;
}

double MeshLight::power() const { return kPi * area_mm2() * radiance_.mean(); }

AreaPoint MeshLight::draw(const Vector2d& square) const {
  // The square's first side is cut by area, so that points which are even in the square are even
  // on the light.
  const CutUnit cut = cut_unit(up_to_, square.x());
  const Triangle& triangle = triangles_[cut.index];
  // Uniform in a triangle [Osada02].
  const double root = std::sqrt(cut.within);
  return {.point = triangle.corner + root * (1.0 - square.y()) * triangle.to_second +
                   root * square.y() * triangle.to_third,
          .normal = triangle.normal,
          .density_per_mm2 = density_per_mm2_};
}

LightBounds MeshLight::bounds() const {
  LightBounds bounds;
  Vector3d sum = Vector3d::Zero();
  double before = 0.0;
  for (std::size_t i = 0; i < triangles_.size(); ++i) {
    const Triangle& triangle = triangles_[i];
    bounds.box.extend(triangle.corner);
    bounds.box.extend((triangle.corner + triangle.to_second).eval());
    bounds.box.extend((triangle.corner + triangle.to_third).eval());
    sum += (up_to_[i] - before) * triangle.normal;
    before = up_to_[i];
  }
  bounds.intensity = area_mm2() * radiance_.mean();
  if (sum.norm() > 1e-9 * area_mm2()) {  // else it shines all around
    bounds.axis = sum.normalized();
    bounds.cos_normals = 1.0;
    for (const Triangle& triangle : triangles_) {
      if (!triangle.normal.isZero(0.0)) {
        bounds.cos_normals = std::min(bounds.cos_normals, triangle.normal.dot(bounds.axis));
      }
    }
  }
  return bounds;
}

double MeshLight::density(const Vector3d& /*from*/, const LightHit& hit) const {
  return area_density(hit, area_mm2());
}

double SphereLight::power() const {
  return 4.0 * kPi * kPi * sphere.radius_mm * sphere.radius_mm * radiance.mean();
}

LightBounds SphereLight::bounds() const {
  const Vector3d reach = Vector3d::Constant(sphere.radius_mm);
  return {.box = {(sphere.centre - reach).eval(), (sphere.centre + reach).eval()},
          .intensity = kPi * sphere.radius_mm * sphere.radius_mm * radiance.mean()};
}

namespace {

/// 1 - cos of half the cone's angle in which a sphere is seen from outside, exact when it is small.
double cone_height(double radius, double distance) {
  const double s = radius / distance;
  return s * s / (1.0 + std::sqrt(1.0 - s * s));
}

}  // namespace

LightSample SphereLight::sample(const Vector3d& from, const Vector2d& square) const {
  const Vector3d way = sphere.centre - from;
  const double distance = way.norm();
  if (!(distance > sphere.radius_mm)) {
    return {};
  }
  const double height = cone_height(sphere.radius_mm, distance);
  const Vector2d disk = concentric_disk(square);
  const double part = disk.squaredNorm();
  // 1 - cos of the angle to the axis, even in the disk's squared radius.
  const double fallen = height * part;
  const double sine = std::sqrt(fallen * (2.0 - fallen));
  const double scale = part > 0.0 ? sine / std::sqrt(part) : 0.0;
  const Vector3d axis = way / distance;
  const Vector3d side = axis.unitOrthogonal();
  const Vector3d direction =
      scale * disk.x() * side + scale * disk.y() * axis.cross(side) + (1.0 - fallen) * axis;
  // The nearer of the two points of the sphere.
  const double across = distance * sine;
  const double half_chord =
      std::sqrt(std::max(0.0, sphere.radius_mm * sphere.radius_mm - across * across));
  const double t = distance * (1.0 - fallen) - half_chord;
  return {.is_found = true,
          .direction = direction,
          .distance_mm = t,
          .normal = (from + t * direction - sphere.centre).normalized(),
          .radiance = radiance,
          .density = 1.0 / (2.0 * kPi * height)};
}

double SphereLight::density(const Vector3d& from, const LightHit& hit) const {
  const double distance = (sphere.centre - from).norm();
  return hit.cosine > 0.0 && distance > sphere.radius_mm
             ? 1.0 / (2.0 * kPi * cone_height(sphere.radius_mm, distance))
             : 0.0;
}

double DiskLight::power() const {
  return kPi * kPi * disk.radius_mm * disk.radius_mm * emits.mean();
}

LightBounds DiskLight::bounds() const {
  const Vector3d reach = disk.radius_mm * (1.0 - disk.normal.array().square()).max(0.0).sqrt();
  return {.box = {(disk.centre - reach).eval(), (disk.centre + reach).eval()},
          .axis = disk.normal,
          .cos_normals = 1.0,
          .intensity = kPi * disk.radius_mm * disk.radius_mm * emits.mean()};
}

AreaPoint DiskLight::draw(const Vector2d& square) const {
  const Vector2d at = disk.radius_mm * concentric_disk(square);
  const Vector3d side = disk.normal.unitOrthogonal();
  return {.point = disk.centre + at.x() * side + at.y() * disk.normal.cross(side),
          .normal = disk.normal,
          .density_per_mm2 = 1.0 / (kPi * disk.radius_mm * disk.radius_mm)};
}

double DiskLight::density(const Vector3d& /*from*/, const LightHit& hit) const {
  return area_density(hit, kPi * disk.radius_mm * disk.radius_mm);
}

double LedLight::power() const {
  // The integral of cos^mu over the hemisphere is 2 pi/(mu + 1).
  return 2.0 * kPi / (square.lobe_mu + 1.0) * square.width_mm * square.height_mm *
         square.radiance;
}

LightBounds LedLight::bounds() const {
  LightBounds bounds{.axis = square.emits,
                     .cos_normals = 1.0,
                     .intensity = square.width_mm * square.height_mm * square.radiance};
  const Vector3d u = 0.5 * square.width_mm * square.u;
  const Vector3d v = 0.5 * square.height_mm * square.v;
  for (const Vector3d& corner :
       {(u + v).eval(), (u - v).eval(), (v - u).eval(), (-u - v).eval()}) {
    bounds.box.extend((square.centre + corner).eval());
  }
  return bounds;
}

AreaPoint LedLight::draw(const Vector2d& square_point) const {
  return {.point = square.centre + (square_point.x() - 0.5) * square.width_mm * square.u +
                   (square_point.y() - 0.5) * square.height_mm * square.v,
          .normal = square.emits,
          .density_per_mm2 = 1.0 / (square.width_mm * square.height_mm)};
}

Vector3d LedLight::radiance(double cosine) const {
  return Vector3d::Constant(square.radiance * std::pow(cosine, square.lobe_mu - 1.0));
}

double PointSource::power() const {
  // The smooth step's mean over its cosines is 1/2.
  return 2.0 * kPi * (1.0 - 0.5 * (light.cos_full + light.cos_end)) * light.intensity.mean();
}

LightBounds PointSource::bounds() const {
  return {.box = {light.position, light.position},
          .axis = light.axis,
          .cos_normals = light.cos_end,
          .has_cosine = false,
          .intensity = light.intensity.mean()};
}

LightSample PointSource::sample(const Vector3d& from, const Vector2d& /*square*/) const {
  const Vector3d way = light.position - from;
  const double distance = way.norm();
  if (!(distance > 0.0)) {
    return {};
  }
  const Vector3d direction = way / distance;
  const double cosine = -light.axis.dot(direction);
  double part = 1.0;
  if (cosine < light.cos_end) {
    return {};
  }
  if (cosine < light.cos_full) {
    const double t = (cosine - light.cos_end) / (light.cos_full - light.cos_end);
    part = t * t * (3.0 - 2.0 * t);
  }
  return {.is_found = true,
          .is_delta = true,
          .direction = direction,
          .distance_mm = distance,
          .radiance = part / (distance * distance) * light.intensity,
          .density = 1.0};
}

double DirectionalSource::power() const {
  return kPi * scene_radius_mm * scene_radius_mm * light.irradiance.mean();
}

LightSample DirectionalSource::sample(const Vector3d& /*from*/,
                                      const Vector2d& /*square*/) const {
  return {.is_found = true,
          .is_delta = true,
          .direction = -light.direction,
          .radiance = light.irradiance,
          .density = 1.0};
}

double EnvironmentSourceLight::power() const {
  return kPi * scene_radius_mm * scene_radius_mm * light.total();
}

LightSample EnvironmentSourceLight::sample(const Vector3d& /*from*/,
                                           const Vector2d& square) const {
  const EnvironmentDirection drawn = light.sample(square);
  return {.is_found = drawn.density > 0.0,
          .direction = drawn.direction,
          .radiance = drawn.radiance,
          .density = drawn.density};
}

double EnvironmentSourceLight::density(const Vector3d& /*from*/, const LightHit& hit) const {
  return light.density(hit.direction);
}

double power(const Light& light) {
  return std::visit([](const auto& kind) { return kind.power(); }, light);
}

std::optional<LightBounds> bounds(const Light& light) {
  return std::visit(
      []<class Kind>(const Kind& kind) -> std::optional<LightBounds> {
        if constexpr (IsSomewhere<Kind>) {
          return kind.bounds();
        } else {
          return std::nullopt;
        }
      },
      light);
}

LightSample sample(const Light& light, const Vector3d& from, const Vector2d& square) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) {
        if constexpr (IsDrawnByArea<Kind>) {
          return area_sample(kind, from, square, MayBeMet<Kind>);
        } else {
          return kind.sample(from, square);
        }
      },
      light);
}

AreaPoint draw(const Light& light, const Vector2d& square) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) -> AreaPoint {
        if constexpr (IsDrawnByArea<Kind>) {
          return kind.draw(square);
        } else {
          return {
              .point = Vector3d::Zero(), .normal = Vector3d::Zero(), .density_per_mm2 = 0.0};
        }
      },
      light);
}

Vector3d area_radiance(const Light& light, double cosine) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) -> Vector3d {
        if constexpr (IsDrawnByArea<Kind>) {
          return kind.radiance(cosine);
        } else {
          return Vector3d::Zero();
        }
      },
      light);
}

double density(const Light& light, const Vector3d& from, const LightHit& hit) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) {
        if constexpr (MayBeMet<Kind>) {
          return kind.density(from, hit);
        } else {
          return 0.0;
        }
      },
      light);
}

bool can_be_met(const Light& light) {
  return std::visit([]<class Kind>(const Kind& /*kind*/) { return MayBeMet<Kind>; }, light);
}

}  // namespace haarlight::render
