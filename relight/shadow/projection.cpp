// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/projection.h"

namespace haarlight::relight {
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

}  // namespace

PlaneProjection project_to_plane(const Plane& plane, const Eigen::Vector3d& light,
                                 const Eigen::Vector3d& vertex) {
  PlaneProjection result;
  const Eigen::Vector3d& n = plane.n;
  if (is_zero(n)) {
    return result;
  }
  // w = a - b without the cancellation of two large heights.
  const PlaneStep at =
      step_to_plane(dot(n, light) + plane.d, dot(n, vertex) + plane.d, dot(n, light - vertex));
  result.status = at.status;
  result.ratio = at.ratio;
  if (!is_valid(at.status)) {
    return result;
  }
  const Eigen::Vector3d point(at.meet(light.x(), vertex.x()), at.meet(light.y(), vertex.y()),
                              at.meet(light.z(), vertex.z()));
  if (!point.allFinite()) {
    result.status = ProjectionStatus::at_light_height;  // beyond the range of double
    return result;
  }
  result.point = without_negative_zero(point);
  return result;
}

}  // namespace haarlight::relight
