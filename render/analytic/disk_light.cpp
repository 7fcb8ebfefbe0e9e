// SPDX-License-Identifier: Apache-2.0
#include "render/analytic/disk_light.h"

#include <cmath>
#include <numbers>

#include <Eigen/Geometry>

namespace haarlight::render {

using Eigen::Vector3d;

/// h over the disk's plane and a beside its axis, S = the product of the distances to the nearest and
/// the farthest point of the rim. A receiver parallel to the disk, and one that faces the axis, get
///
///   E_p = pi/2 (1 - (h^2 + a^2 - R^2)/S),   E_a = 2 pi h a R^2/(S (S + h^2 + a^2 + R^2)),
///
/// and one of another normal, as far as the disk is above its horizon, their sum by its cosines.
std::optional<double> disk_irradiance(const EmittingDisk& disk, const Vector3d& point,
                                      const Vector3d& normal) {
  const Vector3d way = disk.centre - point;
  const double h = -disk.normal.dot(way);
  if (!(h > 0.0)) {
    return 0.0;
  }
  const Vector3d in_plane = way + h * disk.normal;
  const double a = in_plane.norm();
  const double r = disk.radius_mm;
  const Vector3d towards = a > 0.0 ? Vector3d(in_plane / a) : disk.normal.unitOrthogonal();
  const Vector3d across = disk.normal.cross(towards);
  if (normal.dot(way) < r * std::hypot(normal.dot(towards), normal.dot(across))) {
    return std::nullopt;
  }
  const double s = std::hypot(h, a - r) * std::hypot(h, a + r);
  const double t = h * h + (a - r) * (a + r);
  // Where t is near S, the difference of the two is (2 h R)^2/(S + t).
  const double parallel = t > 0.0 ? 4.0 * h * h * r * r / (s * (s + t)) : 1.0 - t / s;
  const double facing = 4.0 * h * a * r * r / (s * (s + h * h + a * a + r * r));
  return 0.5 * std::numbers::pi *
         (-normal.dot(disk.normal) * parallel + normal.dot(towards) * facing);
}

}  // namespace haarlight::render
