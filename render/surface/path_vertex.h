// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <numbers>

#include <Eigen/Core>

#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"

/// @file
/// A point of a path at which it scatters, looked at from either end.
///
/// f is what paths carry there with the cosines of the triangle, not of the shading normal: f of the
/// BSDF times the shading normal's cosine towards the light over the triangle's [Veach97], section
/// 5.3. So a path from the lights carries what one from the camera does (the adjoint BSDF).

namespace haarlight::render {

/// Of an opaque surface that has more than delta lobes.
struct PathVertex {
  Eigen::Vector3d point;
  Eigen::Vector3d flat_normal;  ///< of the triangle, on the side from which it was reached
  Eigen::Vector3d normal;       ///< interpolated
  Eigen::Vector3d back;         ///< unit, to where it was reached from
  Eigen::Matrix3d frame;        ///< shading_frame() of the ray that reached it
  double offset_mm = 0.0;
  bool is_smooth = false;  ///< whether the two normals differ
  Bsdf bsdf;

  /// The normal that shades what is seen from a direction: as shading_normal().
  [[nodiscard]] const Eigen::Vector3d& normal_for(const Eigen::Vector3d& direction) const {
    return normal.dot(direction) > 0.0 ? normal : flat_normal;
  }
};

struct Scattering {
  Eigen::Vector3d f = Eigen::Vector3d::Zero();
  double light_from_eye =
      0.0;  ///< density of the light's direction, per sr, drawn from the eye's
  double eye_from_light = 0.0;  ///< the other way
  double eye_cosine = 0.0;      ///< with the triangle's normal
  double light_cosine = 0.0;
};

/// @param to_eye, to_light  unit, world: towards the camera and the lights along the path. The
///                          shading normal is that which the camera's side sees
[[nodiscard]] inline Scattering scattering_at(const PathVertex& vertex,
                                              const Eigen::Vector3d& to_eye,
                                              const Eigen::Vector3d& to_light) {
  Scattering found;
  found.eye_cosine = vertex.flat_normal.dot(to_eye);
  found.light_cosine = vertex.flat_normal.dot(to_light);
  if (!(found.eye_cosine > 0.0 && found.light_cosine > 0.0)) {
    return found;
  }
  if (const auto* const lambert = std::get_if<Lambert>(&vertex.bsdf);
      lambert != nullptr && !vertex.is_smooth) {
    found.f = lambert->kd * std::numbers::inv_pi;
    found.light_from_eye = found.light_cosine * std::numbers::inv_pi;
    found.eye_from_light = found.eye_cosine * std::numbers::inv_pi;
    return found;
  }
  const Eigen::Matrix3d by_eye =
      vertex.is_smooth ? frame_of(vertex.normal_for(to_eye)) : vertex.frame;
  const Eigen::Vector3d eye = by_eye.transpose() * to_eye;
  const Eigen::Vector3d light = by_eye.transpose() * to_light;
  found.f = evaluate(vertex.bsdf, eye, light);
  if (vertex.is_smooth) {
    found.f *= light.z() / found.light_cosine;
    const Eigen::Matrix3d by_light = frame_of(vertex.normal_for(to_light));
    found.eye_from_light =
        density(vertex.bsdf, by_light.transpose() * to_light, by_light.transpose() * to_eye);
  } else {
    found.eye_from_light = density(vertex.bsdf, light, eye);
  }
  found.light_from_eye = density(vertex.bsdf, eye, light);
  return found;
}

}  // namespace haarlight::render
