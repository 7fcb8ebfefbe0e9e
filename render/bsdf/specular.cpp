// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/specular.h"

#include "render/bsdf/fresnel.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

BsdfSample Mirror::sample(const Vector3d& to_eye, double /*lobe*/,
                          const Vector2d& /*square*/) const {
  BsdfSample drawn;
  drawn.is_found = to_eye.z() > 0.0 && !is_black();
  drawn.is_delta = true;
  drawn.to_light = {-to_eye.x(), -to_eye.y(), to_eye.z()};
  drawn.weight = reflectance;
  return drawn;
}

BsdfSample Dielectric::sample(const Vector3d& to_eye, double lobe,
                              const Vector2d& /*square*/) const {
  BsdfSample drawn;
  drawn.is_found = to_eye.z() > 0.0;
  drawn.is_delta = true;
  if (lobe < fresnel_dielectric(to_eye.z(), ior)) {
    drawn.to_light = {-to_eye.x(), -to_eye.y(), to_eye.z()};
    drawn.weight = Vector3d::Ones();
    return drawn;
  }
  drawn.is_transmission = true;
  drawn.to_light = {-to_eye.x() / ior, -to_eye.y() / ior, -refracted_cosine(to_eye.z(), ior)};
  // What is refracted keeps its flux, not its radiance: L/n^2 is the same on both sides.
  drawn.radiance_scale = 1.0 / (ior * ior);
  drawn.weight = Vector3d::Constant(drawn.radiance_scale);
  return drawn;
}

}  // namespace haarlight::render
