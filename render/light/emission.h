// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <vector>

#include <Eigen/Core>

#include "render/light/light.h"
#include "render/light/scene_lights.h"

/// @file
/// How light leaves the lights of a scene: where paths from them begin.

namespace haarlight::render {

/// A ray of light, drawn.
struct Emission {
  bool is_found = false;  ///< else there is none: a direction in which the light does not shine
  bool is_far = false;    ///< of a light that is infinitely far
  std::size_t light = 0;
  /// On the light; of one that is infinitely far, outside of the scene.
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  ///< unit, in which it goes
  /// Of the light there, unit: where it is a surface; else 0.
  Eigen::Vector3d normal = Eigen::Vector3d::Zero();
  /// Of the normal with the direction; of a light without a surface 1.
  double cosine = 1.0;
  /// What it carries, RGB: radiance times cosine over density().
  Eigen::Vector3d power = Eigen::Vector3d::Zero();
};

/// The lights of a scene as a source of paths: one is chosen by its power, a tenth of the choice uniform;
/// then a ray of it is drawn, as emitted_ray.h says.
class Emitters {
 public:
  /// Keeps a reference. @param middle  RayCaster::scene_middle()
  Emitters(const SceneLights& lights, Eigen::Vector3d middle);

  /// There must be a light. @param point, direction  squares, in [0, 1)^2
  [[nodiscard]] Emission emit(const Eigen::Vector2d& point,
                              const Eigen::Vector2d& direction) const;

  /// With which emit() finds a ray of a light, per mm^2 sr; what the light has but one of (a point,
  /// a direction) does not count.
  /// @param hit  the ray, looked at from where it arrives
  [[nodiscard]] double density(std::size_t light, const LightHit& hit) const;

 private:
  [[nodiscard]] double probability(std::size_t light) const;

  const SceneLights* lights_;
  Eigen::Vector3d middle_;
  std::vector<double> up_to_;  ///< probabilities of the lights up to and with each
};

/// With which render::sample() finds a direction towards a light, per sr, also of one that no ray
/// meets; of a light that has but one direction or point 1.
[[nodiscard]] double asked_density(const Light& light, const Eigen::Vector3d& from,
                                   const LightHit& hit);

/// The cosine of its normal with a direction towards it, where its points have one; else 1.
[[nodiscard]] double cosine_at(const Light& light, const LightSample& sample);

}  // namespace haarlight::render
