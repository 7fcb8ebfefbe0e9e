// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/rays/ray.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Rays against a scene's surfaces, by Embree. Thread-safe after construction. What it costs
/// beside bare Embree: docs/numerics/rays.md.

namespace haarlight::render {

/// What is shaded: a RawHit made exact. The point is the ray's own on the triangle's plane, in
/// double precision; of a ray that grazes the plane it is the triangle's at (u, v). An instance's
/// triangle is that of mesh_of(), as exact.
struct Hit {
  double distance_mm = 0.0;
  Eigen::Vector3d point;        ///< world
  Eigen::Vector3d normal;       ///< shading normal, unit, turned towards the ray's origin
  Eigen::Vector3d flat_normal;  ///< of the triangle, unit, turned towards the ray's origin
  /// Texture coordinates at the point, in double precision: of a mesh its own, of a sphere
  /// sphere_uv; 0 where it has none or its material no texture.
  Eigen::Vector2d uv = Eigen::Vector2d::Zero();
  /// Whether the ray comes from the side from which the triangle's corners go counter-clockwise.
  bool is_front = true;
  int mesh = 0;      ///< number of the surface in the scene
  int triangle = 0;  ///< of a mesh, or of an instance's mesh
  int material = 0;
  /// How far off the surface a ray that leaves it here must start: RayCaster::offset_mm().
  double offset_mm = 0.0;
};

/// Whether the rays of a span go the same way, as a camera's do: packets are then searched
/// together. It changes no answer but where rays meet edges within single precision.
enum class RayOrder : std::uint8_t { coherent, scattered };

class RayCaster {
 public:
  /// Keeps references to the scene's surfaces: the scene outlives the ray caster, is not moved,
  /// and its surfaces stay as they are. A mesh with instances is in Embree's memory once.
  explicit RayCaster(const Scene& scene);
  explicit RayCaster(const Scene&& scene) = delete;
  /// Memory for a scene and its ray caster together, an estimate.
  [[nodiscard]] static std::uint64_t bytes_needed(const Scene& scene);
  ~RayCaster();
  RayCaster(RayCaster&&) noexcept;
  RayCaster& operator=(RayCaster&&) noexcept;
  RayCaster(const RayCaster&) = delete;
  RayCaster& operator=(const RayCaster&) = delete;

  /// The nearest hit of one ray, and of each of many. Many go through Embree 16 at a time, two
  /// to four times as fast. @param hits  (rays.size(),)
  [[nodiscard]] RawHit intersect(const Ray& ray) const;
  void intersect(std::span<const Ray> rays, RayOrder order, std::span<RawHit> hits) const;

  /// @param ray  of unit direction @param raw  its hit
  [[nodiscard]] Hit surface_at(const Ray& ray, const RawHit& raw) const;

  /// The same of many, several times as fast. @param hits  (rays.size(),): where there is none, it is
  /// left as it is
  void surfaces_at(std::span<const Ray> rays, std::span<const RawHit> raw,
                   std::span<Hit> hits) const;

  /// The nearest hit beyond `min_distance_mm`, in one call. @param direction  unit
  [[nodiscard]] std::optional<Hit> intersect(const Eigen::Vector3d& origin,
                                             const Eigen::Vector3d& direction,
                                             double min_distance_mm = 0.0) const;

  /// Whether each ray hits anything. One alone is not made a packet.
  /// @param blocked  (rays.size(),), 1 or 0
  void are_blocked(std::span<const Ray> rays, RayOrder order,
                   std::span<std::uint8_t> blocked) const;

  /// How far off a surface a ray that leaves a point of it must start, along the normal or against
  /// it, so that it does not meet the same surface by the rounding of vertices, origins,
  /// directions and Embree's own sums, all in single precision: a bound by error analysis, as
  /// [WaechterBinder19] have an estimate. It grows with the point's distance from the middle of
  /// the scene's box and with the surface's own size, not with the scene's. Derivation:
  /// docs/numerics/rays.md. Of a triangle whose sides' product is more than 64 times its area (two
  /// shortest, the parallelogram's) it is that of 64 times: no bound any more.
  /// @param surface   its number in the scene @param triangle  of a mesh or of an instance's
  /// @param point     of the surface, world
  [[nodiscard]] double offset_mm(std::uint32_t surface, std::uint32_t triangle,
                                 const Eigen::Vector3d& point) const;

  /// The largest of a surface's points: of a light, for rays that end there.
  [[nodiscard]] double most_offset_mm(std::uint32_t surface) const;

  /// One such offset for all surfaces, for direct light: 2^-18 (4e-6)
  /// of the scene's radius about the middle of its bounding box, so that results do not depend
  /// on a scene's size or position. No smaller detail casts a shadow.
  [[nodiscard]] double ray_offset_mm() const noexcept;

  /// Of the scene's surfaces, about the middle of their bounding box; of an instance the corners of
  /// its mesh's box count.
  [[nodiscard]] double scene_radius_mm() const noexcept;
  /// That middle, where Embree's origin is.
  [[nodiscard]] const Eigen::Vector3d& scene_middle() const noexcept;

  /// The scene's.
  [[nodiscard]] const std::vector<Mesh>& meshes() const noexcept;
  [[nodiscard]] bool has_instances() const noexcept;

  /// Whether anything lies strictly between a point and each of many, shortened by
  /// ray_offset_mm() at each end. @param blocked  (to.size(),), 1 or 0
  void are_blocked(const Eigen::Vector3d& from, std::span<const Eigen::Vector3d> to,
                   std::span<std::uint8_t> blocked) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::render
