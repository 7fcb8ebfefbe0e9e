// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "render/surface/irradiance_gather.h"
#include "render/surface/irradiance_octree.h"
#include "render/surface/path_integrator.h"

/// @file
/// Irradiance caching [Ward88], biased: E[(D|G|S)*]L with indirect light of near-diffuse surfaces
/// interpolated. Before the picture, records of indirect irradiance are made where the camera sees
/// near-diffuse surfaces, each from paths over its hemisphere; then paths are traced as by
/// PathIntegrator, and end where a record tells the rest. Light that comes directly, over ideal mirrors
/// and glass alone, or to the glossy part of a surface, is traced.
///
/// Records are made in batches of a fixed order: of a grid of the picture's pixels that becomes finer.
/// What a batch adds only the next ones see, so that neither threads nor the part of the picture
/// that is wanted change a record.

namespace haarlight::render {

struct IrradianceCacheOptions {
  double accuracy = 0.3;  ///< a: a record is used up to a times the distance of what it sees
  int gather_rays = 512;  ///< of a record, at least 4
  /// R_min and R_max, of the scene's radius.
  double least_radius = 0.04;
  double most_radius = 0.25;
  bool has_gradients = true;  ///< else records are taken to be the same all about
  std::uint64_t memory_bytes = std::numeric_limits<std::uint64_t>::max();
  std::function<bool()> is_stopped;  ///< the cache is then left as it is; empty: never
};

class IrradianceCacheIntegrator final : public TileRenderer {
 public:
  /// Makes the cache, for the camera's whole picture, on all threads. Keeps references to all but the
  /// camera.
  /// @param environment  of the scene's source; nothing: the scene has none
  /// @param path         its has_features, first_x, first_y are of the picture
  /// @throws Error  the cache needs more than memory_bytes
  IrradianceCacheIntegrator(const Scene& scene, const RayCaster& caster,
                            const Environment* environment, const Camera& camera,
                            const PathOptions& path, const IrradianceCacheOptions& options);

  [[nodiscard]] const IrradianceOctree& cache() const noexcept { return cache_; }
  /// That were cast for the cache.
  [[nodiscard]] std::uint64_t cache_rays() const noexcept { return n_rays_; }
  /// How well records foretell each other: of each that others reach, the squared difference from their
  /// mean, over the squared irradiance of all; its root. Their noise is in it, and the distance at which
  /// records are is larger than that of most points: it is more than the cache is off by.
  /// 0 where no record is reached.
  [[nodiscard]] double leave_one_out() const;

  /// Fills surface_layers().
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

 private:
  struct Seen;
  [[nodiscard]] std::optional<Seen> seen(int x, int y) const;
  void fill();
  void fill(int step, int dx, int dy);
  void gather(const PathIntegrator& paths, std::span<const Seen> points,
              std::span<IrradianceRecord> records);

  const Scene* scene_;
  const RayCaster* caster_;
  Camera camera_;
  PathOptions path_;
  IrradianceCacheOptions options_;
  HemisphereCells cells_;
  RadiusLimits limits_;
  IrradianceOctree cache_;
  std::uint64_t n_rays_ = 0;
  PathIntegrator gatherer_;
  PathIntegrator display_;
};

}  // namespace haarlight::render
