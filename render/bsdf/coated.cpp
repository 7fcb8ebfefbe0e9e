// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/coated.h"

#include <algorithm>
#include <numbers>

#include "render/bsdf/coat_albedo.h"
#include "render/bsdf/fresnel.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

Vector3d kd_under_coat(const Vector3d& seen, double ior, double alpha) {
  const double mean = CoatAlbedo::table().mean_transmittance(alpha, ior);
  const Eigen::Array3d denser = ior * ior * seen.array();
  return denser / (mean * (1.0 - seen.array()) + denser);
}

double Coated::reflectance(double cosine) const {
  return CoatAlbedo::table().reflectance(cosine, facets.alpha, ior);
}

Vector3d Coated::base() const {
  const double mean = CoatAlbedo::table().mean_transmittance(facets.alpha, ior);
  return std::numbers::inv_pi * kd.array() /
         ((1.0 - kd.array()) * (ior * ior) + kd.array() * mean);
}

Vector3d Coated::base_albedo(double cosine) const {
  const double mean = CoatAlbedo::table().mean_transmittance(facets.alpha, ior);
  return base() * (std::numbers::pi * mean * (1.0 - reflectance(cosine)));
}

double Coated::coat_fraction(double cosine) const {
  const double coat = reflectance(cosine);
  return coat / (coat + base_albedo(cosine).mean());
}

Vector3d Coated::evaluate(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return Vector3d::Zero();
  }
  return base() * ((1.0 - reflectance(to_eye.z())) * (1.0 - reflectance(to_light.z()))) +
         glossy(to_eye, to_light);
}

Vector3d Coated::glossy(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return Vector3d::Zero();
  }
  const double towards = std::clamp((to_eye + to_light).normalized().dot(to_eye), 0.0, 1.0);
  return Vector3d::Constant(fresnel_dielectric(towards, ior) *
                            facets.reflection(to_eye, to_light));
}

double Coated::density(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return 0.0;
  }
  const double coat = coat_fraction(to_eye.z());
  return coat * facets.density(to_eye, to_light) +
         (1.0 - coat) * to_light.z() * std::numbers::inv_pi;
}

BsdfSample Coated::sample(const Vector3d& to_eye, double lobe, const Vector2d& square) const {
  BsdfSample drawn;
  if (!(to_eye.z() > 0.0)) {
    return drawn;
  }
  drawn.to_light = lobe < coat_fraction(to_eye.z())
                       ? mirrored(to_eye, facets.visible_normal(to_eye, square)).normalized()
                       : cosine_direction(square);
  drawn.density = density(to_eye, drawn.to_light);
  drawn.is_found = drawn.density > 0.0;
  if (drawn.is_found) {
    drawn.weight = evaluate(to_eye, drawn.to_light) * (drawn.to_light.z() / drawn.density);
  }
  return drawn;
}

Vector3d Coated::albedo(const Vector3d& to_eye) const {
  return base_albedo(to_eye.z()).array() + reflectance(to_eye.z());
}

}  // namespace haarlight::render
