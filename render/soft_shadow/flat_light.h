// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A flat area light in its own frame: what soft shadows are cast by.

namespace haarlight::render {

/// What a square or polygonal light counts as.
enum class LightShape : std::uint8_t {
  own,   ///< itself
  disk,  ///< the disk of the same area about its centre, as [Jakobsen04] has all lights
};
inline constexpr auto kLightShapeWords = std::to_array<std::string_view>({"own", "disk"});
constexpr std::span<const std::string_view> words_of(LightShape) { return kLightShapeWords; }

/// A disk, or a convex polygon. The light frame: origin at `centre`, z the direction in which it
/// shines, lengths in units of `radius_mm`, right-handed.
struct FlatLight {
  static constexpr int kNoSurface = -1;

  std::string name;  ///< "disk 2", "mesh 5 (ceiling)", "light 0": for reports
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();                ///< world, mm
  Eigen::Matrix3d light_from_world = Eigen::Matrix3d::Identity();  ///< rotation alone
  double radius_mm = 1.0;  ///< of the disk; of a polygon: of the farthest corner from `centre`
  /// Empty: the unit disk. Else corners of a convex polygon about the origin, light frame,
  /// counter-clockwise as seen from where it shines.
  std::vector<Eigen::Vector2d> corners;
  int surface = kNoSurface;  ///< its number in the scene; none: an LED

  [[nodiscard]] bool is_disk() const noexcept { return corners.empty(); }
  /// Of the disk or polygon, units of radius_mm squared.
  [[nodiscard]] double area() const;
  [[nodiscard]] Eigen::Vector3d to_light(const Eigen::Vector3d& world) const {
    return light_from_world * (world - centre) / radius_mm;
  }
  [[nodiscard]] Eigen::Vector3d to_world(const Eigen::Vector3d& light) const {
    return centre + radius_mm * (light_from_world.transpose() * light);
  }
};

/// The scene's lights: disks, flat convex meshes (a quad) that emit, LEDs; in this order.
/// @param scene  without instances (with_instances_expanded)
/// @param where  what names the scene, for errors
/// @throws Error  a light that has no flat convex shape: a sphere, a curved or concave mesh, a
///                point, a direction, an environment; or no light at all
[[nodiscard]] std::vector<FlatLight> flat_lights(const Scene& scene, LightShape shape,
                                                 const std::string& where);

}  // namespace haarlight::render
