// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/light_grid.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Direct light at a surface point from every square light, per light, with shadows.
///
///     D = 1/pi integral L cos(theta) cos^mu(theta_l) / r^2 V dA
///     S = integral (n + 8)/(8 pi) (n.h)^n L cos(theta) cos^mu(theta_l) / r^2 V dA
///
/// so that a pixel's radiance is kd D + ks S for any albedo. A light that the scene's outline, as
/// seen from the point, does not cross is seen or hidden as a whole: one ray tells for all such
/// lights side by side, and Gauss points integrate them (2 x 2 leave an error of 3e-8). A light
/// that it crosses is sampled at jittered strata. docs/numerics/direct-light.md.

namespace haarlight::render {

struct DirectLightOptions {
  int mixed_grid = 16;  ///< n x n strata of a light that the outline crosses
  /// The definition, for comparison: every light by its strata. 8 to 100 times slower; what the
  /// two differ by is in docs/numerics/direct-light.md.
  bool sample_all = false;
  std::uint64_t seed = 0;
};

/// What direct light can render: one kind of material, without textures, and triangles.
/// @param where    the scene's file @param program  whose direct light it is
/// @throws Error   another bsdf than blinn_phong, or a texture, with the material's name; an exact
///                 sphere, a disk. Instances are with_instances_expanded()'s
void require_for_direct_light(const Scene& scene, const std::string& where,
                              std::string_view program);

/// Where light is received and the direction from which it is seen.
struct SurfacePoint {
  Eigen::Vector3d point;
  Eigen::Vector3d normal;       ///< shading normal, unit
  Eigen::Vector3d flat_normal;  ///< unit, on the eye's side
  Eigen::Vector3d to_eye;       ///< unit
  int material = 0;
  double offset_mm = 0.0;  ///< Hit::offset_mm, for rays that go on from there; 0: not known
};

/// One light's contribution at one point, for its radiance.
struct LightContribution {
  double diffuse = 0.0;   ///< D: times kd
  double specular = 0.0;  ///< S: times ks
  double visible = 0.0;   ///< visible fraction of the light, 0..1
  double error = 0.0;     ///< standard error of `visible`
};

/// Thread-safe. Keeps references to the ray caster and copies of the lights.
class DirectLight {
 public:
  DirectLight(const RayCaster& caster, std::span<const SquareLight> lights,
              const DirectLightOptions& options = {});

  /// Working memory of one thread.
  struct Scratch;

  /// @param material  of blinn_phong; S is left 0 when its `ks` is 0
  /// @param key       of the random numbers: the same key gives the same result
  /// @param contributions    (n_lights,)
  /// @return          rays cast
  // NOLINTNEXTLINE(modernize-use-nodiscard): the contributions are the result, the count a by-product
  std::uint64_t evaluate(const SurfacePoint& surface, const Material& material,
                         std::uint64_t key, std::span<LightContribution> contributions) const;

  [[nodiscard]] int n_lights() const noexcept { return static_cast<int>(lights_.size()); }

 private:
  struct Outline;

  void mark_outline(const SurfacePoint& surface, Scratch& scratch) const;
  void classify(const SurfacePoint& surface, Scratch& scratch) const;
  void cast_strata(int k, std::span<const Eigen::Vector2d> cells, Scratch& scratch) const;
  void sample_mixed(int k, const SurfacePoint& surface, const Material& material,
                    std::uint64_t key, Scratch& scratch, LightContribution& contribution) const;

  const RayCaster* caster_;
  std::vector<SquareLight> lights_;
  DirectLightOptions options_;
  std::vector<Eigen::Vector2d> jitter_;     ///< tables of stratified points in [0, 1)^2
  std::shared_ptr<const Outline> outline_;  ///< none with sample_all
};

}  // namespace haarlight::render
