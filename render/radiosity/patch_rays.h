// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/light/scene_lights.h"
#include "render/radiosity/element_slopes.h"
#include "render/radiosity/elements.h"
#include "render/radiosity/exchange.h"
#include "render/radiosity/patches.h"
#include "render/sampling/sampler.h"

/// @file
/// All that looks at a scene's surfaces for radiosity, as its patches see them.

namespace haarlight::render {

class PatchRays {
 public:
  /// Keeps references to all but the numbers. @param n_rays  of each side, and of each point that is
  /// gathered at
  PatchRays(const Scene& scene, const RayCaster& caster, const Environment* environment,
            const Patches& patches, std::uint32_t n_rays, std::uint64_t seed);

  /// Two of each side that lies partly within a body.
  [[nodiscard]] Elements elements() const;

  /// What rays of a side meet. [0] of those from its part without, [1] within.
  struct Met {
    std::array<std::vector<RayCount>, 2> counts;
    std::array<std::uint32_t, 2> n_rays{};
  };
  [[nodiscard]] Met met_by(const Elements& elements, std::size_t side) const;

  struct Direct {
    std::array<Eigen::Vector3d, 2> irradiance{
        Eigen::Vector3d::Zero(),
        Eigen::Vector3d::Zero()};  ///< of lights, mean over either part
    Eigen::Vector3d albedo = Eigen::Vector3d::Zero();
  };
  /// By points of lights and by directions, weighted by the power heuristic [Veach95].
  [[nodiscard]] Direct direct_at(const Elements& elements, std::size_t side) const;

  /// The mean over rays by the cosine law of the radiosity of what they meet.
  /// @param number  of the point: whose samples are its own
  [[nodiscard]] Eigen::Vector3d arriving(const Elements& elements, const CutTriangle& triangle,
                                         bool is_front, const Eigen::Vector2d& uv,
                                         std::size_t number, const ElementSlopes& light) const;

 private:
  /// Rays to points of lights, and what arrives along each.
  struct Towards {
    std::vector<Ray> rays;
    std::vector<Eigen::Vector3d> arrives;
    std::vector<std::uint32_t> sample;
  };

  [[nodiscard]] PixelSamples numbers(std::size_t of, int whose) const;
  [[nodiscard]] Hit on(const CutTriangle& triangle, bool is_front,
                       const Eigen::Vector2d& uv) const;
  [[nodiscard]] std::size_t side_of(const Ray& ray, const PatchPoint& met) const;
  [[nodiscard]] std::optional<std::size_t> side_of(const Ray& ray, const RawHit& raw) const;
  [[nodiscard]] std::optional<Seen> seen(std::optional<std::size_t> side) const;
  [[nodiscard]] std::vector<SeenFromPoint> seen_from(std::size_t side, std::uint32_t n_points,
                                                     std::uint32_t n_of_point) const;
  [[nodiscard]] std::optional<std::vector<Seen>> seen_within(std::size_t side) const;
  void cast(const std::vector<Ray>& rays, std::vector<RawHit>& hits) const;
  void ask(const Hit& hit, std::uint32_t sample, const Eigen::Vector2d& square,
           Towards& towards) const;
  [[nodiscard]] Eigen::Vector3d met_light(const Hit& from, const Ray& ray,
                                          const RawHit& raw) const;

  const Scene* scene_;
  const RayCaster* caster_;
  const Patches* patches_;
  std::uint32_t n_rays_;
  std::uint64_t seed_;
  SceneLights lights_;
  std::vector<double> light_offsets_;
};

}  // namespace haarlight::render
