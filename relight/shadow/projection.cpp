// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/projection.h"

#include <cmath>

namespace haarlight {
namespace {

// Sums in a fixed order: negating n and d negates every term, product and partial sum exactly,
// so ratios of two such sums keep their bits. -ffp-contract=off is set for the whole project.
double dot(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return (a.x() * b.x() + a.y() * b.y()) + a.z() * b.z();
}

bool is_zero(const Eigen::Vector3d& v) { return v.x() == 0.0 && v.y() == 0.0 && v.z() == 0.0; }

/// -0 becomes +0: the only bits that flipping the plane could still change.
Eigen::Vector3d without_negative_zero(const Eigen::Vector3d& p) {
  return {p.x() + 0.0, p.y() + 0.0, p.z() + 0.0};
}

ProjectionStatus side_of(double ratio) {
  if (ratio == 0.0) {
    return ProjectionStatus::on_plane;
  }
  return ratio > 0.0 ? ProjectionStatus::above : ProjectionStatus::below;
}

}  // namespace

std::string_view to_string(ProjectionStatus status) noexcept {
  switch (status) {
    case ProjectionStatus::above:
      return "above";
    case ProjectionStatus::on_plane:
      return "on_plane";
    case ProjectionStatus::below:
      return "below";
    case ProjectionStatus::light_in_plane:
      return "light_in_plane";
    case ProjectionStatus::at_light_height:
      return "vertex_at_light_height";
    case ProjectionStatus::beyond_light:
      return "beyond_light";
    case ProjectionStatus::invalid_plane:
      return "invalid_plane";
  }
  return "?";
}

PlaneProjection project_to_plane(const Plane& plane, const Eigen::Vector3d& light,
                                 const Eigen::Vector3d& vertex) {
  PlaneProjection result;
  const Eigen::Vector3d& n = plane.n;
  if (is_zero(n)) {
    return result;
  }
  const double a = dot(n, light) + plane.d;
  const double b = dot(n, vertex) + plane.d;
  // w = a - b without the cancellation of two large heights.
  const double w = dot(n, light - vertex);
  if (a == 0.0) {
    result.status = ProjectionStatus::light_in_plane;
    return result;
  }
  result.ratio = b / a + 0.0;
  if (w == 0.0) {
    result.status = ProjectionStatus::at_light_height;
    return result;
  }
  // Valid exactly when w/a = 1 - b/a > 0. Not w > 0 alone: flipping the plane reverses that.
  if ((w > 0.0) != (a > 0.0)) {
    result.status = ProjectionStatus::beyond_light;
    return result;
  }
  // eq. (4), as a step along the ray from the end closer to the plane.
  const Eigen::Vector3d step = std::abs(b) <= std::abs(a)
                                   ? Eigen::Vector3d(vertex + (vertex - light) * (b / w))
                                   : Eigen::Vector3d(light + (vertex - light) * (a / w));
  if (!step.allFinite()) {
    result.status = ProjectionStatus::at_light_height;  // beyond the range of double
    return result;
  }
  result.status = b == 0.0 ? ProjectionStatus::on_plane : side_of(result.ratio);
  if (result.status == ProjectionStatus::on_plane && b != 0.0) {
    result.status = (b > 0.0) == (a > 0.0) ? ProjectionStatus::above : ProjectionStatus::below;
  }
  result.point = without_negative_zero(step);
  return result;
}

PlaneProjection project_along(const Plane& plane, const Eigen::Vector3d& to_light,
                              const Eigen::Vector3d& vertex) {
  PlaneProjection result;
  if (is_zero(plane.n)) {
    return result;
  }
  const double a = dot(plane.n, to_light);
  const double b = dot(plane.n, vertex) + plane.d;
  if (a == 0.0) {
    result.status = ProjectionStatus::light_in_plane;
    return result;
  }
  const double t = b / a;  // the light is infinitely far: no vertex lies beyond it
  result.point = without_negative_zero(vertex - to_light * t);
  result.status = side_of(t);
  return result;
}

Eigen::Matrix4d projection_matrix(const Plane& plane, const Eigen::Vector3d& light) {
  const Eigen::Vector4d l(light.x(), light.y(), light.z(), 1.0);
  const Eigen::Vector4d row(plane.n.x(), plane.n.y(), plane.n.z(), plane.d);
  const double a = dot(plane.n, light) + plane.d;
  return a * Eigen::Matrix4d::Identity() - l * row.transpose();
}

Eigen::Matrix4d directional_matrix(const Plane& plane, const Eigen::Vector3d& to_light) {
  const Eigen::Vector4d l(to_light.x(), to_light.y(), to_light.z(), 0.0);
  const Eigen::Vector4d row(plane.n.x(), plane.n.y(), plane.n.z(), plane.d);
  return dot(plane.n, to_light) * Eigen::Matrix4d::Identity() - l * row.transpose();
}

}  // namespace haarlight
