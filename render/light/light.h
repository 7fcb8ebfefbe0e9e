// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <limits>
#include <optional>
#include <variant>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"
#include "render/light/environment_light.h"
#include "render/light/light_bvh.h"

/// @file
/// One light of a scene, of any kind: one value. How a direction towards it is drawn from a point,
/// and with what density. All functions are pure.

namespace haarlight::render {

/// A direction towards a light, drawn from a point.
struct LightSample {
  /// Else nothing arrives from there: the point is behind the light, or within it.
  bool is_found = false;
  bool is_delta = false;  ///< of a light without extent: no other way finds it
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();          ///< unit, from the point
  double distance_mm = std::numeric_limits<double>::infinity();  ///< to the light
  /// Of the light there, unit, towards the point; 0 where it is no surface that could hide itself.
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  /// RGB. Of a delta light: the irradiance of a surface that faces it, instead.
  Eigen::Vector3d radiance = Eigen::Vector3d::Zero();
  double density = 0.0;  ///< per sr; of a delta light 1
};

/// A point of a light that a ray has met.
struct LightHit {
  Eigen::Vector3d direction;  ///< unit, of the ray
  double distance_mm = 0.0;   ///< from the point that the ray has left
  double cosine = 0.0;        ///< of the light's normal with the way back
};

/// A point of a light that is drawn by area, not yet seen from anywhere.
struct AreaPoint {
  Eigen::Vector3d point;
  Eigen::Vector3d normal;  ///< unit, of the side that shines
  double density_per_mm2;
};

/// Triangles of one mesh, drawn by area: even on them.
class MeshLight {
 public:
  MeshLight(const Mesh& mesh, Eigen::Vector3d radiance);

  [[nodiscard]] double area_mm2() const noexcept {
    return up_to_.empty() ? 0.0 : up_to_.back();
  }
  [[nodiscard]] double power() const;
  [[nodiscard]] LightBounds bounds() const;
  [[nodiscard]] AreaPoint draw(const Eigen::Vector2d& square) const;
  /// Towards a point at that cosine to its normal.
  [[nodiscard]] Eigen::Vector3d radiance(double /*cosine*/) const { return radiance_; }
  [[nodiscard]] double density(const Eigen::Vector3d& from, const LightHit& hit) const;

 private:
  struct Triangle {
    Eigen::Vector3d corner;
    Eigen::Vector3d to_second;
    Eigen::Vector3d to_third;
    Eigen::Vector3d normal;  ///< unit
  };
  Eigen::Vector3d radiance_;
  std::vector<double> up_to_;  ///< area of the triangles up to and with each
  double density_per_mm2_;
  std::vector<Triangle> triangles_;
};

/// Drawn evenly in the cone in which it is seen [Shirley96].
struct SphereLight {
  Sphere sphere;
  Eigen::Vector3d radiance;

  [[nodiscard]] double power() const;
  [[nodiscard]] LightBounds bounds() const;
  [[nodiscard]] LightSample sample(const Eigen::Vector3d& from,
                                   const Eigen::Vector2d& square) const;
  [[nodiscard]] double density(const Eigen::Vector3d& from, const LightHit& hit) const;
};

/// Drawn by area.
struct DiskLight {
  Disk disk;
  Eigen::Vector3d emits;

  [[nodiscard]] double power() const;
  [[nodiscard]] LightBounds bounds() const;
  [[nodiscard]] AreaPoint draw(const Eigen::Vector2d& square) const;
  [[nodiscard]] Eigen::Vector3d radiance(double /*cosine*/) const { return emits; }
  [[nodiscard]] double density(const Eigen::Vector3d& from, const LightHit& hit) const;
};

/// An LED: drawn by area. Nothing meets it.
struct LedLight {
  SquareLight square;

  [[nodiscard]] double power() const;
  [[nodiscard]] LightBounds bounds() const;
  [[nodiscard]] AreaPoint draw(const Eigen::Vector2d& square_point) const;
  [[nodiscard]] Eigen::Vector3d radiance(double cosine) const;
};

struct PointSource {
  PointLight light;

  [[nodiscard]] double power() const;
  [[nodiscard]] LightBounds bounds() const;
  [[nodiscard]] LightSample sample(const Eigen::Vector3d& from,
                                   const Eigen::Vector2d& square) const;
};

struct DirectionalSource {
  DirectionalLight light;
  double scene_radius_mm;

  /// Of what arrives in a scene of that radius.
  [[nodiscard]] double power() const;
  [[nodiscard]] LightSample sample(const Eigen::Vector3d& from,
                                   const Eigen::Vector2d& square) const;
};

struct EnvironmentSourceLight {
  EnvironmentLight light;
  double scene_radius_mm;

  /// Of what arrives in a scene of that radius.
  [[nodiscard]] double power() const;
  [[nodiscard]] LightSample sample(const Eigen::Vector3d& from,
                                   const Eigen::Vector2d& square) const;
  [[nodiscard]] double density(const Eigen::Vector3d& from, const LightHit& hit) const;
};

using Light = std::variant<MeshLight, SphereLight, DiskLight, LedLight, PointSource,
                           DirectionalSource, EnvironmentSourceLight>;

/// U mm^2 sr, mean over the colours: what it emits, or sends into the scene.
[[nodiscard]] double power(const Light& light);

/// Nothing: it is infinitely far.
[[nodiscard]] std::optional<LightBounds> bounds(const Light& light);

/// @param square  in [0, 1)^2
[[nodiscard]] LightSample sample(const Light& light, const Eigen::Vector3d& from,
                                 const Eigen::Vector2d& square);

/// What `sample` does first for a light that is drawn by area; of another the density is 0.
[[nodiscard]] AreaPoint draw(const Light& light, const Eigen::Vector2d& square);
/// Of such a light, towards a point at that cosine to its normal.
[[nodiscard]] Eigen::Vector3d area_radiance(const Light& light, double cosine);

/// With which `sample` finds the direction of a ray from `from` that has met the light, per sr; 0 of
/// a light that no ray meets.
[[nodiscard]] double density(const Light& light, const Eigen::Vector3d& from,
                             const LightHit& hit);

/// Whether a ray may meet it: else only `sample` finds it.
[[nodiscard]] bool can_be_met(const Light& light);

}  // namespace haarlight::render
