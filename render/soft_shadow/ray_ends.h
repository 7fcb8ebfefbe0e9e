// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "render/soft_shadow/flat_light.h"
#include "render/soft_shadow/occluder_edges.h"

/// @file
/// Which rays from a point to a light single precision decides: those with no face about either end,
/// nearer than the ray and the face are rounded. The others are decided in double precision.

namespace haarlight::render {

/// What a ray in double precision finds.
enum class Passage : std::uint8_t {
  open,
  hidden,
  unknown,  ///< it meets something within the rounding of double precision
};

/// Of one light. All coordinates but `point` are of the light frame.
class RayEnds {
 public:
  /// All but `scene` outlive it.
  /// @param vertices  of the edges
  /// @param planes    of the edges' faces: unit normal, offset
  RayEnds(const Scene& scene, const OccluderEdges& edges,
          std::span<const Eigen::Vector3d> vertices, std::span<const Eigen::Vector4d> planes,
          const RayCaster& caster, const FlatLight& light);

  /// What a ray of no length and any surface are off by together.
  [[nodiscard]] double least_slack() const noexcept { return of_surfaces_; }

  /// Looks once for the faces about the light that rays from these receivers may come near: where a ray
  /// stays away from all of them, end_if_sure() does not look again.
  void look_about_light(std::span<const Eigen::Vector3d> receivers);

  /// Where single precision decides on the ray: how far before the light's plane it ends, so that it meets
  /// nothing that is not before the light. It depends on the ray and the scene alone.
  /// @param point  world, of x
  /// @param x      before the light
  /// @return  none where only double precision can decide
  [[nodiscard]] std::optional<double> end_if_sure(const Eigen::Vector3d& point,
                                                  const Eigen::Vector3d& x,
                                                  const Eigen::Vector2d& target) const;

  /// The ray in double precision, from end to end. The light does not hide itself, nor does what is
  /// nearer to its plane than kNearestZ.
  /// @param clearance  from the target to the next silhouette's image, at least
  [[nodiscard]] Passage passage(const Eigen::Vector3d& point, const Eigen::Vector3d& x,
                                const Eigen::Vector2d& target, double clearance) const;

 private:
  [[nodiscard]] bool is_before_light(std::uint32_t face) const;
  [[nodiscard]] double slack(double length) const;
  [[nodiscard]] bool is_about_point(std::uint32_t face, double from_middle_mm,
                                    const Eigen::Vector3d& x) const;
  [[nodiscard]] bool has_face_about_target(const Eigen::Vector3d& x,
                                           const Eigen::Vector3d& target) const;
  [[nodiscard]] double room_within(std::uint32_t face, const Eigen::Vector3d& q) const;
  [[nodiscard]] Passage past(std::uint32_t face, const Eigen::Vector3d& x,
                             const Eigen::Vector3d& target, double clearance) const;

  const OccluderEdges& edges_;
  std::span<const Eigen::Vector3d> vertices_;
  std::span<const Eigen::Vector4d> planes_;
  const RayCaster& caster_;
  const FlatLight& light_;
  double of_surfaces_ = 0.0;  // what any surface is off by, light frame
  double free_half_ = 0.0;    // of the square about the light without a face near its plane
};

}  // namespace haarlight::render
