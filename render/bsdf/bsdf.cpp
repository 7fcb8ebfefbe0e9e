// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/bsdf.h"

#include "haarlight/core/error.h"
#include "render/bsdf/coat_albedo.h"
#include "render/scene/texture.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

Vector3d kd_at(const Material& material, const Hit& hit) {
  const MaterialTexture& texture = material.kd_texture;
  if (texture.file.empty()) {
    return material.kd;
  }
  HAARLIGHT_EXPECTS(texture.picture != nullptr, "textures are loaded");
  return material.kd.cwiseProduct(texture.picture->at(texture.scale.cwiseProduct(hit.uv)));
}

}  // namespace

Bsdf bsdf_of(const Scene& scene, const Hit& hit) {
  const Material& material = scene.materials[static_cast<std::size_t>(hit.material)];
  switch (material.bsdf) {
    case BsdfKind::blinn_phong:
      break;
    case BsdfKind::oren_nayar:
      return OrenNayar::of(kd_at(material, hit), material.sigma);
    case BsdfKind::mirror:
      return Mirror{.reflectance = material.reflectance};
    case BsdfKind::dielectric:
      return Dielectric{.ior = hit.is_front ? material.ior : 1.0 / material.ior};
    case BsdfKind::conductor:
      return Conductor{
          .facets = {.alpha = material.roughness}, .eta = material.eta, .k = material.k};
    case BsdfKind::coated:
      HAARLIGHT_EXPECTS(
          material.ior >= CoatAlbedo::kLowestIor && material.ior <= CoatAlbedo::kHighestIor,
          "a coat's index of refraction");
      return Coated{.kd = material.is_kd_seen ? kd_under_coat(kd_at(material, hit),
                                                              material.ior, material.roughness)
                                              : kd_at(material, hit),
                    .ior = material.ior,
                    .facets = {.alpha = material.roughness}};
  }
  if (!(material.ks > 0.0)) {
    return Lambert{.kd = kd_at(material, hit)};
  }
  return BlinnPhong{
      .kd = kd_at(material, hit), .ks = material.ks, .exponent = material.exponent};
}

bool is_black(const Bsdf& bsdf) {
  return std::visit([](const auto& kind) { return kind.is_black(); }, bsdf);
}

bool has_smooth_part(const Bsdf& bsdf) {
  return !is_black(bsdf) &&
         std::visit([]<class Kind>(const Kind&) { return !kIsSpecular<Kind>; }, bsdf);
}

Vector3d evaluate(const Bsdf& bsdf, const Vector3d& to_eye, const Vector3d& to_light) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) -> Vector3d {
        if constexpr (kIsSpecular<Kind>) {
          return Vector3d::Zero();
        } else {
          return kind.evaluate(to_eye, to_light);
        }
      },
      bsdf);
}

double density(const Bsdf& bsdf, const Vector3d& to_eye, const Vector3d& to_light) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) {
        if constexpr (kIsSpecular<Kind>) {
          return 0.0;
        } else {
          return kind.density(to_eye, to_light);
        }
      },
      bsdf);
}

Vector3d near_diffuse_albedo(const Bsdf& bsdf, const Vector3d& to_eye) {
  return std::visit(
      [&]<class Kind>(const Kind& kind) -> Vector3d {
        if constexpr (kHasNearDiffusePart<Kind>) {
          return kind.near_diffuse_albedo(to_eye);
        } else {
          return Vector3d::Zero();
        }
      },
      bsdf);
}

BsdfSample sample(const Bsdf& bsdf, const Vector3d& to_eye, double lobe,
                  const Vector2d& square) {
  return std::visit([&](const auto& kind) { return kind.sample(to_eye, lobe, square); }, bsdf);
}

Vector3d albedo(const Bsdf& bsdf, const Vector3d& to_eye) {
  return std::visit([&](const auto& kind) { return kind.albedo(to_eye); }, bsdf);
}

}  // namespace haarlight::render
