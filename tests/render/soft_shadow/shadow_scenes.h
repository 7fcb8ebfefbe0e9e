// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "render/soft_shadow/soft_shadow.h"
#include "tests/render/soft_shadow/convex_truth.h"

/// @file
/// Scenes of a light and closed convex pieces for soft shadow tests, with their visibility in closed
/// form.

namespace haarlight::test {

enum class LightKind : std::uint8_t { disk, square_mesh, led };

/// Materials 0, dark, and 1, which emits.
inline constexpr int kDark = 0;
inline constexpr int kBright = 1;

struct ShadowScene {
  render::Scene scene;
  std::vector<ConvexPiece> pieces;  ///< world
  LightKind light = LightKind::disk;
  Eigen::Vector3d centre = {0.0, 0.0, 2.0};
  Eigen::Matrix3d light_from_world = Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  double radius = 0.5;  ///< of the disk; half a square's side

  /// Of a convex mesh, closed or flat.
  void add(const render::Mesh& mesh);
  /// By the shadows on the light's plane, without the renderer's code for lights.
  [[nodiscard]] double truth(const Eigen::Vector3d& point) const;
};

/// A light without anything before it.
[[nodiscard]] ShadowScene scene_under_light(LightKind light, const Eigen::Vector3d& centre,
                                            const Eigen::Matrix3d& light_from_world,
                                            double radius);
/// Level, shining down from (0, 0, height).
[[nodiscard]] ShadowScene scene_under_light(LightKind light, double height, double radius);

/// The hull of points of which no four lie in a plane, closed, outward.
[[nodiscard]] render::Mesh hull_of(const std::vector<Eigen::Vector3d>& points);

struct ShadowValues {
  std::vector<render::LightShadow> shadows;
  render::ShadowCounts counts;
};
[[nodiscard]] ShadowValues shadow_values(const render::Scene& scene,
                                         const std::vector<Eigen::Vector3d>& points,
                                         const render::SoftShadowOptions& options = {});

[[nodiscard]] constexpr bool is_exact(render::ShadowKind kind) {
  return kind != render::ShadowKind::unsure && kind != render::ShadowKind::traced;
}

}  // namespace haarlight::test
