// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cmath>
#include <span>
#include <string_view>

#include <Eigen/Core>

/// @file
/// Where the ray from a light through a vertex meets the shadow plane n.x + d = 0 [Kim13, eq.
/// (4)]. With a = n.l + d and b = n.v + d the point is p = (a v - b l)/(a - b). Evaluated as a
/// step from the nearer of v and l, which keeps 4 eps N at every scale
/// (docs/numerics/shadow.md); the matrix form loses up to 1e4 eps far from the origin. Pure;
/// safe from any thread.

#include "haarlight/core/enum_words.h"

namespace haarlight::relight {

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
inline constexpr auto kProjectionStatusWords = std::to_array<std::string_view>(
    {"above", "on_plane", "below", "light_in_plane", "vertex_at_light_height", "beyond_light",
     "invalid_plane"});
constexpr std::span<const std::string_view> words_of(ProjectionStatus) {
  return kProjectionStatusWords;
}

/// True for above, on_plane and below: there is a point.
[[nodiscard]] constexpr bool is_valid(ProjectionStatus status) noexcept {
  return status == ProjectionStatus::above || status == ProjectionStatus::on_plane ||
         status == ProjectionStatus::below;
}

/// Eq. (4) along one ray, from heights over the plane alone. It holds in every frame that an
/// affine map makes of the world: millimetres, or a plane picture's columns and rows.
struct PlaneStep {
  ProjectionStatus status = ProjectionStatus::invalid_plane;
  double ratio = 0.0;          ///< b/a; 0 for light_in_plane
  double step = 0.0;           ///< b/(a - b), from the vertex, in v - l; may be infinite
  double nearer = 0.0;         ///< the same from the nearer of v and l
  bool is_from_light = false;  ///< which is nearer

  /// One coordinate of p. @param light, vertex  theirs
  [[nodiscard]] double meet(double light, double vertex) const noexcept {
    return (is_from_light ? light : vertex) + (vertex - light) * nearer;
  }
};

/// @param a, b  signed heights of light and vertex; any unit
/// @param w     a - b; told apart because two large heights cancel
[[nodiscard]] inline PlaneStep step_to_plane(double a, double b, double w) noexcept {
  PlaneStep found;
  if (a == 0.0) {
    found.status = ProjectionStatus::light_in_plane;
    return found;
  }
  found.ratio = b / a + 0.0;
  if (w == 0.0) {
    found.status = ProjectionStatus::at_light_height;
    return found;
  }
  // Valid exactly when w/a = 1 - b/a > 0. Never w > 0: a flip of the plane turns that round.
  if ((w > 0.0) != (a > 0.0)) {
    found.status = ProjectionStatus::beyond_light;
    return found;
  }
  found.status = b == 0.0                 ? ProjectionStatus::on_plane
                 : (b > 0.0) == (a > 0.0) ? ProjectionStatus::above
                                          : ProjectionStatus::below;
  found.step = b / w;
  found.is_from_light = std::abs(b) > std::abs(a);
  found.nearer = found.is_from_light ? a / w : found.step;
  return found;
}

struct PlaneProjection {
  ProjectionStatus status = ProjectionStatus::invalid_plane;
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< world; zero unless is_valid(status)
  double ratio = 0.0;                               ///< b/a: height of v over height of l
};

/// @param light, vertex  positions, finite
[[nodiscard]] PlaneProjection project_to_plane(const Plane& plane, const Eigen::Vector3d& light,
                                               const Eigen::Vector3d& vertex);

}  // namespace haarlight::relight
