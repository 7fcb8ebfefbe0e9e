// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/conductor.h"

#include <algorithm>

#include "render/bsdf/fresnel.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

Vector3d Conductor::evaluate(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return Vector3d::Zero();
  }
  const double towards = std::clamp((to_eye + to_light).normalized().dot(to_eye), 0.0, 1.0);
  return fresnel_conductor(towards, eta, k) * facets.reflection(to_eye, to_light);
}

double Conductor::density(const Vector3d& to_eye, const Vector3d& to_light) const {
  return are_above(to_eye, to_light) ? facets.density(to_eye, to_light) : 0.0;
}

BsdfSample Conductor::sample(const Vector3d& to_eye, double /*lobe*/,
                             const Vector2d& square) const {
  BsdfSample drawn;
  if (!(to_eye.z() > 0.0)) {
    return drawn;
  }
  const Vector3d half = facets.visible_normal(to_eye, square);
  drawn.to_light = mirrored(to_eye, half).normalized();
  drawn.density = density(to_eye, drawn.to_light);
  drawn.is_found = drawn.density > 0.0;
  if (drawn.is_found) {
    drawn.weight = fresnel_conductor(std::clamp(half.dot(to_eye), 0.0, 1.0), eta, k) *
                   facets.unshadowed(to_eye.z(), drawn.to_light.z());
  }
  return drawn;
}

Vector3d Conductor::albedo(const Vector3d& to_eye) const {
  return fresnel_conductor(std::clamp(to_eye.z(), 0.0, 1.0), eta, k);
}

}  // namespace haarlight::render
