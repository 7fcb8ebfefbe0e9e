// SPDX-License-Identifier: Apache-2.0
#include "render/light/scene_lights.h"

#include <numeric>
#include <optional>
#include <utility>

#include "haarlight/core/error.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {
/// Fraction of the choice by power in which lights are alike, so that none is missed, however dim.
constexpr double kAlike = 0.1;
}  // namespace

SceneLights::SceneLights(const Scene& scene, const Environment* environment,
                         double scene_radius_mm, LightChoice choice, bool always_chooses)
    : choice_(choice) {
  const auto add_surface = [&](int material, const auto& make) {
    const Vector3d& radiance = scene.materials[static_cast<std::size_t>(material)].emits;
    Surface surface;
    if (radiance.maxCoeff() > 0.0 && add(make(radiance))) {
      surface = {.light = static_cast<int>(lights_.size()) - 1, .radiance = radiance};
      surface_of_.push_back(static_cast<std::uint32_t>(surfaces_.size()));
    }
    surfaces_.push_back(surface);
  };
  for (const Mesh& mesh : scene.meshes) {
    add_surface(mesh.material,
                [&](const Vector3d& radiance) { return MeshLight(mesh, radiance); });
  }
  for (const Sphere& sphere : scene.spheres) {
    add_surface(sphere.material, [&](const Vector3d& radiance) {
      return SphereLight{sphere, radiance};
    });
  }
  for (const Disk& disk : scene.disks) {
    add_surface(disk.material, [&](const Vector3d& radiance) {
      return DiskLight{disk, radiance};
    });
  }
  for (const Instance& instance : scene.instances) {
    add_surface(material_of(scene, instance), [&](const Vector3d& radiance) {
      return MeshLight(mesh_of(scene, instance), radiance);
    });
  }
  for (const SquareLight& square : scene.lights) {
    add(LedLight{square});
  }
  for (const PointLight& light : scene.point_lights) {
    add(PointSource{light});
  }
  for (const DirectionalLight& light : scene.directional_lights) {
    add(DirectionalSource{light, scene_radius_mm});
  }
  if (environment != nullptr && scene.environment) {
    if (add(EnvironmentSourceLight{EnvironmentLight(*environment, scene.environment->scale),
                                   scene_radius_mm})) {
      environment_ = lights_.size() - 1;
    }
  }
  has_choice_ = lights_.size() > 1 || always_chooses;
  if (choice == LightChoice::tree) {
    build_tree();
  } else {
    weigh();
  }
}

std::uint64_t SceneLights::bytes_needed(const Scene& scene) {
  constexpr std::uint64_t kTriangle = sizeof(double) + 4 * sizeof(Vector3d);  // MeshLight's
  const auto emits = [&](int material) {
    return scene.materials[static_cast<std::size_t>(material)].emits.maxCoeff() > 0.0;
  };
  std::uint64_t sum = 0;
  for (const Mesh& mesh : scene.meshes) {
    sum += emits(mesh.material) ? mesh.triangles.size() * kTriangle : 0;
  }
  for (const Instance& instance : scene.instances) {
    const Mesh& mesh = scene.meshes[static_cast<std::size_t>(instance.mesh)];
    sum += emits(material_of(scene, instance)) ? mesh.triangles.size() * kTriangle : 0;
  }
  return sum;
}

bool SceneLights::add(Light light) {
  const double own = power(light);
  if (!(own > 0.0)) {
    return false;
  }
  powers_.push_back(own);
  powers_up_to_.push_back(own + (powers_up_to_.empty() ? 0.0 : powers_up_to_.back()));
  is_met_.push_back(can_be_met(light) ? 1 : 0);
  lights_.push_back(std::move(light));
  return true;
}

void SceneLights::weigh() {
  const double sum = std::accumulate(powers_.begin(), powers_.end(), 0.0);
  const double alike =
      (choice_ == LightChoice::power ? kAlike : 1.0) / static_cast<double>(powers_.size());
  double up_to = 0.0;
  for (const double power : powers_) {
    up_to += alike + (choice_ == LightChoice::power ? (1.0 - kAlike) * (power / sum) : 0.0);
    up_to_.push_back(up_to);
  }
}

void SceneLights::build_tree() {
  std::vector<LightBounds> near;
  for (std::size_t i = 0; i < lights_.size(); ++i) {
    if (const std::optional<LightBounds> found = bounds(lights_[i])) {
      number_of_.push_back(near_lights_.size());
      near_lights_.push_back(i);
      near.push_back(*found);
    } else {
      number_of_.push_back(far_lights_.size());
      far_lights_.push_back(i);
    }
  }
  tree_ = LightBvh(near);
  const std::size_t n_groups = far_lights_.size() + (near.empty() ? 0 : 1);
  for (std::size_t i = 0; i < n_groups; ++i) {
    up_to_.push_back(static_cast<double>(i + 1));
  }
}

std::optional<ChosenLight> SceneLights::choose(const LitPoint& at,
                                               const Vector2d& square) const {
  HAARLIGHT_EXPECTS(!lights_.empty() && choice_ != LightChoice::all, "one light to choose");
  if (!has_choice_) {
    return ChosenLight{.index = 0, .probability = 1.0, .square = square};
  }
  const CutUnit cut = cut_unit(up_to_, square.x());
  if (choice_ != LightChoice::tree) {
    return ChosenLight{.index = cut.index,
                       .probability = probability(cut.index, at),
                       .square = {cut.within, square.y()}};
  }
  const double group = 1.0 / up_to_.back();
  if (cut.index < far_lights_.size()) {
    return ChosenLight{.index = far_lights_[cut.index],
                       .probability = group,
                       .square = {cut.within, square.y()}};
  }
  const std::optional<LightBvh::Choice> near = tree_.choose(at.point, at.normal, cut.within);
  if (!near) {
    return std::nullopt;
  }
  return ChosenLight{.index = near_lights_[near->light],
                     .probability = group * near->probability,
                     .square = {near->within, square.y()}};
}

ChosenLight SceneLights::choose_emitter(const Vector2d& square) const {
  HAARLIGHT_EXPECTS(!lights_.empty(), "one light to choose");
  const CutUnit cut = cut_unit(powers_up_to_, square.x());
  return {.index = cut.index,
          .probability = emitter_probability(cut.index),
          .square = {cut.within, square.y()}};
}

double SceneLights::emitter_probability(std::size_t light) const {
  return (powers_up_to_[light] - (light == 0 ? 0.0 : powers_up_to_[light - 1])) /
         powers_up_to_.back();
}

double SceneLights::probability(std::size_t light, const LitPoint& at) const {
  if (choice_ == LightChoice::all || !has_choice_) {
    return 1.0;
  }
  if (choice_ != LightChoice::tree) {
    return (up_to_[light] - (light == 0 ? 0.0 : up_to_[light - 1])) / up_to_.back();
  }
  const std::size_t number = number_of_[light];
  const bool is_far = number < far_lights_.size() && far_lights_[number] == light;
  return (is_far ? 1.0 : tree_.probability(number, at.point, at.normal)) / up_to_.back();
}

}  // namespace haarlight::render
