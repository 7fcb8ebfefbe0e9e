// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/scene/scene.h"
#include "render/light/light.h"

/// @file
/// All lights of a scene, and which of them are asked at a point.

namespace haarlight::render {

/// Strategies for many lights.
enum class LightChoice : std::uint8_t {
  all,      ///< each of them: exact in the choice, and as dear as there are many
  uniform,  ///< one, all alike
  power,    ///< one, by its power; a tenth of the choice is uniform
  tree,     ///< one, by what it could contribute at the point at most (LightBvh)
};
inline constexpr auto kLightChoiceWords =
    std::to_array<std::string_view>({"all", "uniform", "power", "tree"});
constexpr std::span<const std::string_view> words_of(LightChoice) { return kLightChoiceWords; }

/// Where lights are asked for.
struct LitPoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, of the side that is lit
};

struct ChosenLight {
  std::size_t index = 0;
  double probability = 0.0;
  Eigen::Vector2d square = Eigen::Vector2d::Zero();  ///< what the choice has left of the square
};

/// Lights that emit nothing are left out.
class SceneLights {
 public:
  /// Keeps references to the scene and the environment.
  /// @param environment      of the scene's source; nothing: the scene has none
  /// @param scene_radius_mm  of its surfaces
  /// @param always_chooses   also where there is one light: to measure what a choice costs
  SceneLights(const Scene& scene, const Environment* environment, double scene_radius_mm,
              LightChoice choice, bool always_chooses = false);

  /// Memory for the lights that are meshes or instances, an estimate.
  [[nodiscard]] static std::uint64_t bytes_needed(const Scene& scene);

  [[nodiscard]] std::size_t size() const noexcept { return lights_.size(); }
  [[nodiscard]] const Light& operator[](std::size_t i) const { return lights_[i]; }
  [[nodiscard]] LightChoice choice() const noexcept { return choice_; }

  /// Whether a ray may meet it: else it is found by asking alone.
  [[nodiscard]] bool is_met(std::size_t light) const { return is_met_[light] != 0; }

  [[nodiscard]] bool is_any_met() const { return std::ranges::any_of(lights_, can_be_met); }

  /// One light. There must be one, and the choice is not `all`. Nothing: none could contribute.
  /// @param square  in [0, 1)^2; its first side is cut by the lights' probabilities, so that
  ///                points which are even in the square are even on the lights
  [[nodiscard]] std::optional<ChosenLight> choose(const LitPoint& at,
                                                  const Eigen::Vector2d& square) const;
  /// With which a light is asked there. 1 of `all`.
  [[nodiscard]] double probability(std::size_t light, const LitPoint& at) const;

  /// One light, by its power: so that all rays that are drawn from the lights (emitted_ray.h) carry
  /// as much, but for colour. There must be one.
  /// @param square  in [0, 1)^2, cut as by `choose`
  [[nodiscard]] ChosenLight choose_emitter(const Eigen::Vector2d& square) const;
  /// With which choose_emitter() finds a light.
  [[nodiscard]] double emitter_probability(std::size_t light) const;

  /// The light that a surface of the scene is.
  [[nodiscard]] std::optional<std::size_t> of_surface(std::uint32_t surface) const {
    const int light = surfaces_[surface].light;
    return light < 0 ? std::nullopt : std::optional(static_cast<std::size_t>(light));
  }
  /// The surface of the scene that a light is.
  [[nodiscard]] std::optional<std::uint32_t> surface_of(std::size_t light) const {
    return light < surface_of_.size() ? std::optional(surface_of_[light]) : std::nullopt;
  }
  [[nodiscard]] std::optional<std::size_t> environment() const { return environment_; }
  [[nodiscard]] const Eigen::Vector3d& radiance_of_surface(std::uint32_t surface) const {
    return surfaces_[surface].radiance;
  }

 private:
  struct Surface {
    int light = -1;
    Eigen::Vector3d radiance = Eigen::Vector3d::Zero();
  };
  bool add(Light light);
  void weigh();
  void build_tree();

  LightChoice choice_;
  bool has_choice_ = true;
  std::vector<Light> lights_;
  std::vector<std::uint8_t> is_met_;  ///< by light
  std::vector<double> powers_;
  std::vector<double> powers_up_to_;  ///< sums of them, up to and with each
  std::vector<double> up_to_;         ///< weights of the choice up to and with each
  // Of the choice by a tree: each light that is infinitely far, and the tree as a whole, alike.
  LightBvh tree_;
  std::vector<std::size_t> far_lights_;
  std::vector<std::size_t> near_lights_;  ///< by their number in the tree
  std::vector<std::size_t> number_of_;    ///< by light: in one of these
  std::vector<Surface> surfaces_;
  std::vector<std::uint32_t> surface_of_;  ///< by light: surfaces come first
  std::optional<std::size_t> environment_;
};

}  // namespace haarlight::render
