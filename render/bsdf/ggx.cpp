// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/ggx.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "render/sampling/warp.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

/// s = sqrt(cos^2 + alpha^2 sin^2), by which Smith's functions have no pole at grazing angles:
///
///   G(o) = 2 cos_o / (cos_o + s_o)
///   G(o, i) = 2 cos_o cos_i / (cos_o s_i + cos_i s_o)        [Heitz14]
double Ggx::stretched(double cosine) const {
  const double cos2 = cosine * cosine;
  return std::sqrt(cos2 + alpha * alpha * std::max(0.0, 1.0 - cos2));
}

/// D = 1 / (pi alpha^2 ((x^2 + y^2)/alpha^2 + z^2)^2)
double Ggx::density_of_normals(const Vector3d& half) const {
  const double x = half.x() / alpha;
  const double y = half.y() / alpha;
  const double root = alpha * (x * x + y * y + half.z() * half.z());
  return 1.0 / (pi * root * root);
}

double Ggx::reflection(const Vector3d& to_eye, const Vector3d& to_light) const {
  const Vector3d half = (to_eye + to_light).normalized();
  return density_of_normals(half) /
         (2.0 * (to_eye.z() * stretched(to_light.z()) + to_light.z() * stretched(to_eye.z())));
}

double Ggx::unshadowed(double cos_eye, double cos_light) const {
  const double s_eye = stretched(cos_eye);
  return cos_light * (cos_eye + s_eye) / (cos_eye * stretched(cos_light) + cos_light * s_eye);
}

/// max(0, h.o) D G(o) / cos_o, over 4 h.o: a half vector turns half as far as the direction.
double Ggx::density(const Vector3d& to_eye, const Vector3d& to_light) const {
  const Vector3d half = (to_eye + to_light).normalized();
  return density_of_normals(half) / (2.0 * (to_eye.z() + stretched(to_eye.z())));
}

Vector3d Ggx::visible_normal(const Vector3d& to_eye, const Vector2d& square) const {
  // Stretched until the facets are a hemisphere's; there the sum of the direction and a point of
  // the cap z > -direction.z is a visible normal.
  const Vector3d o = Vector3d(alpha * to_eye.x(), alpha * to_eye.y(), to_eye.z()).normalized();
  const Vector2d around = at_turns(square.x());
  const double up = 1.0 - square.y() * (1.0 + o.z());  // z of the cap
  const double sin = std::sqrt(std::max(0.0, 1.0 - up * up));
  const Vector3d half = o + Vector3d(sin * around.x(), sin * around.y(), std::max(up, -o.z()));
  return Vector3d(alpha * half.x(), alpha * half.y(), half.z()).normalized();
}

}  // namespace haarlight::render
