// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/rays/ray_caster.h"
#include "render/soft_shadow/disk_visibility.h"
#include "render/soft_shadow/flat_light.h"
#include "render/soft_shadow/occluder_edges.h"

/// @file
/// Which fraction of a flat area light each point of a scene sees, exactly: the images of all edges
/// that part the light as seen from the point cut it into cells, and one ray tells whether the least
/// covered of them is seen at all. No samples, no noise, hard borders of umbra and penumbra.
/// After [Jakobsen04], with all edges instead of one: decision 0013. What it costs and how far off it
/// is: docs/numerics/soft-shadow.md. The approximations are reached by the same call, to be compared.

namespace haarlight::render {

/// The exact way, and the named approximations and baselines that it is compared with.
enum class ShadowMethod : std::uint8_t {
  exact,
  rays,              ///< shadow rays to jittered strata of the light, at every point
  point_silhouette,  ///< the exact areas, of the silhouettes as the light's centre sees them
  d_buffer,          ///< d_buffer.h, the winner by piece
  paper,             ///< d_buffer.h, the farthest of all, as [Jakobsen04] prints it
};
inline constexpr auto kShadowMethodWords =
    std::to_array<std::string_view>({"exact", "rays", "point-silhouette", "d-buffer", "paper"});
constexpr std::span<const std::string_view> words_of(ShadowMethod) {
  return kShadowMethodWords;
}

constexpr bool is_buffered(ShadowMethod method) {
  return method == ShadowMethod::d_buffer || method == ShadowMethod::paper;
}

/// How a value was found.
enum class ShadowKind : std::uint8_t {
  whole,    ///< no edge parts the light: exact, 0 or 1
  edge,     ///< one straight line across a disk parts it: exact
  outline,  ///< several lines do, or any across a polygon: exact
  assumed,  ///< rests on the assumption of its method: none of the exact one's
  unsure,  ///< its ray passes an edge, or ends at a face, closer than double precision resolves
  traced,  ///< by rays alone: curved surfaces in the way, or more edges than allowed
};
inline constexpr auto kShadowKindWords = std::to_array<std::string_view>(
    {"whole", "edge", "outline", "assumed", "unsure", "traced"});
constexpr std::span<const std::string_view> words_of(ShadowKind) { return kShadowKindWords; }

struct LightShadow {
  float visibility =
      0.0F;  ///< of the light's area, [0, 1]; 0 in the light's plane and behind it
  ShadowKind kind = ShadowKind::whole;
};

struct SoftShadowOptions {
  ShadowMethod method = ShadowMethod::exact;
  int grid = 256;  ///< cells across and down: time and memory, not the result
  int most_edges =
      512;  ///< that part the light at one point; where there are more, it is traced
  /// Of traced points in the penumbra, in the mean and at 99 %: a pilot of them finds the rays that
  /// it takes.
  double max_error = 0.01;
  int strata = 0;    ///< rays of a traced point: its square; 0: as many as max_error takes
  int texels = 512;  ///< of a D-buffer, across and down
  VisibilityForm form = VisibilityForm::exact;  ///< of a D-buffer
};

/// Rays of one traced point, and what the pilot found of their error.
struct TracedError {
  int strata = 0;  ///< the rays are its square; 0: no point was traced
  /// |difference| from 4 times as many rays over the pilot's points in the penumbra.
  double mean = 0.0;
  double at_99 = 0.0;
  std::int64_t n_pilot = 0;  ///< points of the pilot in the penumbra; 0: nothing is known
};

/// What a light's grid holds, and what the points of one call needed.
struct ShadowCounts {
  std::int64_t n_edges = 0;        ///< of the scene
  std::int64_t n_candidates = 0;   ///< that may part the light for some point
  std::int64_t n_listed = 0;       ///< in all cells
  std::int64_t n_rays = 0;         ///< in single precision
  std::int64_t n_double_rays = 0;  ///< where that cannot tell
  std::array<std::int64_t, kShadowKindWords.size()> by_kind = {};
  std::int64_t n_penumbra = 0;           ///< 0 < visibility < 1
  std::int64_t n_clamped = 0;            ///< of a D-buffer: t was outside of [0, 1]
  std::int64_t n_without_extrusion = 0;  ///< edges that a D-buffer left out
  TracedError traced;
  double grid_seconds = 0.0;
  double shadow_seconds = 0.0;
};

/// Of one light. Thread-safe but for evaluate().
class SoftShadow {
 public:
  /// All but `light` and `options` outlive it.
  /// @param scene  without instances (with_instances_expanded)
  /// @param edges  of the scene's meshes
  /// @param where  what names the scene, for errors
  /// @throws Error  what a D-buffer refuses: DBuffer
  SoftShadow(const Scene& scene, const OccluderEdges& edges, const RayCaster& caster,
             FlatLight light, const SoftShadowOptions& options, const std::string& where);
  ~SoftShadow();
  SoftShadow(SoftShadow&&) noexcept;
  SoftShadow& operator=(SoftShadow&&) noexcept;
  SoftShadow(const SoftShadow&) = delete;
  SoftShadow& operator=(const SoftShadow&) = delete;

  /// As often as there are points to ask for, of a scene that stays: values, kinds and counts of visibility do
  /// not depend on which were asked before. The light's grid is made for the first points, and again only for
  /// points beyond it, then for all so far; with spheres or disks in the way for each call's points alone.
  /// @param points  world, off meshes towards the side that is lit by more than double precision rounds:
  /// nearer, they are unsure. Off spheres and disks by RayCaster::offset_mm(), and off all surfaces by that
  /// where values are traced: nearer, a value may be the surface's other side's. Nearer to the light's
  /// plane than 1e-9 of its radius a point is in it, and what is there hides nothing.
  /// @param shadows (points.size(),)
  void evaluate(std::span<const Eigen::Vector3d> points, std::span<LightShadow> shadows);

  [[nodiscard]] const FlatLight& light() const noexcept;
  /// Of the last evaluate(); the first one's seconds have the constructor's.
  [[nodiscard]] const ShadowCounts& counts() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::render
