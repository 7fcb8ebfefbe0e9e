// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/rays/ray_caster.h"
#include "render/soft_shadow/flat_light.h"
#include "render/soft_shadow/occluder_edges.h"

/// @file
/// Which fraction of a flat area light each point of a scene sees, exactly: the images of all edges
/// that part the light as seen from the point cut it into cells, and one ray tells whether the least
/// covered of them is seen at all. No samples, no noise, hard borders of umbra and penumbra.
/// After [Jakobsen04], with all edges instead of one: decision 0013. What it costs and how far off it
/// is: docs/numerics/soft-shadow.md.

namespace haarlight::render {

/// How a value was found.
enum class ShadowKind : std::uint8_t {
  whole,    ///< no edge parts the light: exact, 0 or 1
  edge,     ///< one straight line across a disk parts it: exact
  outline,  ///< several lines do, or any across a polygon: exact
  unsure,   ///< as outline, but its ray passes occluders closer than single precision resolves
  traced,   ///< by rays alone: curved surfaces in the way, or more edges than allowed
};
inline constexpr auto kShadowKindWords =
    std::to_array<std::string_view>({"whole", "edge", "outline", "unsure", "traced"});
constexpr std::span<const std::string_view> words_of(ShadowKind) { return kShadowKindWords; }

struct LightShadow {
  float visibility =
      0.0F;  ///< of the light's area, [0, 1]; 0 in the light's plane and behind it
  ShadowKind kind = ShadowKind::whole;
};

struct SoftShadowOptions {
  int grid = 256;  ///< cells across and down: time and memory, not the result
  int most_edges =
      512;  ///< that part the light at one point; where there are more, it is traced
  int traced_strata = 16;  ///< rays of a traced point: its square
};

/// What a light's grid holds, and what the points needed.
struct ShadowCounts {
  std::int64_t n_edges = 0;       ///< of the scene
  std::int64_t n_candidates = 0;  ///< that may part the light for some point
  std::int64_t n_listed = 0;      ///< in all cells
  std::int64_t n_rays = 0;
  std::array<std::int64_t, kShadowKindWords.size()> by_kind = {};
  std::int64_t n_penumbra = 0;  ///< 0 < visibility < 1
  double grid_seconds = 0.0;
  double shadow_seconds = 0.0;
};

/// Of one light. Thread-safe but for evaluate().
class SoftShadow {
 public:
  /// All but `light` and `options` outlive it.
  /// @param scene  without instances (with_instances_expanded)
  /// @param edges  of the scene's meshes
  SoftShadow(const Scene& scene, const OccluderEdges& edges, const RayCaster& caster,
             FlatLight light, const SoftShadowOptions& options);
  ~SoftShadow();
  SoftShadow(SoftShadow&&) noexcept;
  SoftShadow& operator=(SoftShadow&&) noexcept;
  SoftShadow(const SoftShadow&) = delete;
  SoftShadow& operator=(const SoftShadow&) = delete;

  /// The light's grid is made for the first points, and again only for points beyond it.
  /// @param points  world, off all surfaces by RayCaster::offset_mm() towards the side that is lit:
  /// nearer, a value of any kind may be the surface's other side's
  /// @param shadows (points.size(),)
  void evaluate(std::span<const Eigen::Vector3d> points, std::span<LightShadow> shadows);

  [[nodiscard]] const FlatLight& light() const noexcept;
  [[nodiscard]] const ShadowCounts& counts() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::render
