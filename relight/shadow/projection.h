// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string_view>

#include <Eigen/Core>

/// @file
/// Where the ray from a light through a vertex meets the shadow plane n.x + d = 0 [Kim13, eq.
/// (4)]. With a = n.l + d and b = n.v + d the point is p = (a v - b l)/(a - b). Evaluated as a
/// step from the nearer of v and l, which keeps 4 eps N at every scale
/// (docs/numerics/shadow.md); the matrix form loses up to 1e4 eps far from the origin. Pure;
/// safe from any thread.

namespace haarlight {

/// n.x + d = 0. n need not have length 1; (n, d) and (-n, -d) give the same bits everywhere.
struct Plane {
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  double d = 0.0;
};

enum class ProjectionStatus {
  above,            ///< the vertex is between plane and light: b/a in (0, 1)
  on_plane,         ///< b = 0: the vertex is its own projection
  below,            ///< the plane is between vertex and light: b/a < 0
  light_in_plane,   ///< a = 0: every shadow is a line
  at_light_height,  ///< a = b: the ray is parallel to the plane, there is no point
  beyond_light,     ///< b/a > 1: the line meets the plane, the light's ray does not
  invalid_plane,    ///< n = 0
};

[[nodiscard]] std::string_view to_string(ProjectionStatus status) noexcept;

/// True for above, on_plane and below: there is a point.
[[nodiscard]] constexpr bool is_valid(ProjectionStatus status) noexcept {
  return status == ProjectionStatus::above || status == ProjectionStatus::on_plane ||
         status == ProjectionStatus::below;
}

struct PlaneProjection {
  ProjectionStatus status = ProjectionStatus::invalid_plane;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< world; zero unless is_valid(status)
  double ratio = 0.0;                               ///< b/a: height of v over height of l
};

/// @param light, vertex  positions, finite
[[nodiscard]] PlaneProjection project_to_plane(const Plane& plane, const Eigen::Vector3d& light,
                                               const Eigen::Vector3d& vertex);

/// The same along parallel rays. Valid wherever the rays are not parallel to the plane and come
/// from the light's side; `light_in_plane` when they are.
/// @param to_light  any length but 0
[[nodiscard]] PlaneProjection project_along(const Plane& plane, const Eigen::Vector3d& to_light,
                                            const Eigen::Vector3d& vertex);

/// M = a I - [l; 1][n; d]^T, so that p ~ M [v; 1]: for display and GPUs, near the origin. The
/// sign of w is meaningless; the error is up to 1e4 eps far from the origin.
[[nodiscard]] Eigen::Matrix4d projection_matrix(const Plane& plane,
                                                const Eigen::Vector3d& light);
/// M = (n.l) I - [l; 0][n; d]^T for parallel rays.
[[nodiscard]] Eigen::Matrix4d directional_matrix(const Plane& plane,
                                                 const Eigen::Vector3d& to_light);

}  // namespace haarlight
