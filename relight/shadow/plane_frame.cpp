// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shadow/plane_frame.h"

#include <cmath>

#include "haarlight/core/error.h"

namespace haarlight::relight {

Eigen::Vector3d PlaneFrame::world_of(double column, double row) const {
  return origin + (x0_mm + column * texel_mm) * u + (y0_mm - row * texel_mm) * v;
}

Eigen::Vector2d PlaneFrame::picture_of(const Eigen::Vector3d& world) const {
  const Eigen::Vector3d offset = world - origin;
  return {(offset.dot(u) - x0_mm) / texel_mm, (y0_mm - offset.dot(v)) / texel_mm};
}

double PlaneFrame::height_of(const Eigen::Vector3d& world) const {
  return plane.n.dot(world) + plane.d;
}

PlaneFrame make_plane_frame(const ShadowPlane& plane) {
  const double length = plane.n.norm();
  HAARLIGHT_EXPECTS(length > 0.0, "the plane's normal is not zero");
  HAARLIGHT_EXPECTS(plane.texel_mm > 0.0, "a texel has a size");
  PlaneFrame frame;
  frame.plane = {plane.n / length, plane.d / length};
  frame.origin = plane.origin;
  frame.u = plane.u;
  frame.v = plane.v;
  frame.texel_mm = plane.texel_mm;
  frame.width = static_cast<int>(std::lround(plane.extent_u_mm / plane.texel_mm));
  frame.height = static_cast<int>(std::lround(plane.extent_v_mm / plane.texel_mm));
  HAARLIGHT_EXPECTS(frame.width > 0 && frame.height > 0, "a plane picture has pixels");
  frame.x0_mm = -0.5 * frame.width * frame.texel_mm;
  frame.y0_mm = 0.5 * frame.height * frame.texel_mm;
  return frame;
}

}  // namespace haarlight::relight
