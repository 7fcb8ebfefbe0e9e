// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "render/light/light.h"

/// @file
/// Light as it leaves a light: rays that are drawn from it, with their densities, for methods that
/// follow light from where it is made. All functions are pure.

namespace haarlight::render {

/// A ray along which a light shines.
struct EmittedRay {
  /// On the light itself: a ray that is cast starts off it. Of a light that is infinitely far: on a
  /// disk before the scene.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, away from the light
  /// Unit, of the side that shines, or of the disk before the scene, which is `direction`. Of a
  /// point 0.
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  double cosine = 1.0;  ///< of direction and normal; of a point 1
  /// RGB, along the ray. Of a point its intensity, of a directional light its irradiance, instead.
  Eigen::Vector3d radiance = Eigen::Vector3d::Zero();
  double position_density = 1.0;   ///< per mm^2; of a point 1
  double direction_density = 1.0;  ///< per sr; of a directional light 1
  bool has_one_position = false;   ///< a point: no ray meets it
  bool has_one_direction = false;  ///< a directional light
  bool is_far = false;             ///< it is infinitely far

  /// What the ray carries of the light's power, RGB: radiance cos / (density of position and
  /// direction). Its mean over the rays is the power. U mm^2 sr
  [[nodiscard]] Eigen::Vector3d flux() const {
    const double density = position_density * direction_density;
    if (!(density > 0.0)) {  // a spot's edge, by rounding
      return Eigen::Vector3d::Zero();
    }
    return cosine / density * radiance;
  }
};

/// Rays are drawn by what they carry: points evenly by area, directions by cosine (an LED's by its
/// lobe, a spot's by its cone, an environment's by its light). So each ray of a light carries the
/// same, but for colour.
/// @param scene_middle           RayCaster::scene_middle(); for lights that are infinitely far
/// @param position, direction    in [0, 1)^2; a point uses the second alone, a directional light the
///                               first
[[nodiscard]] EmittedRay emit(const Light& light, const Eigen::Vector3d& scene_middle,
                              const Eigen::Vector2d& position,
                              const Eigen::Vector2d& direction);

/// The densities with which `emit` finds a ray.
struct EmissionDensity {
  double position = 0.0;   ///< per mm^2; of a point 1
  double direction = 0.0;  ///< per sr; of a directional light 1 in its direction. 0: never
};

/// @param cosine     of the light's normal, where it leaves, with the direction; of a point or a far
///                   light any
/// @param direction  unit, away from the light
[[nodiscard]] EmissionDensity emission_density(const Light& light, double cosine,
                                               const Eigen::Vector3d& direction);

}  // namespace haarlight::render
