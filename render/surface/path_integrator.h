// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/light/mesh_lights.h"
#include "render/loop/tile_renderer.h"
#include "render/sampling/sampler.h"

/// @file
/// Path tracing [Kajiya86]: E[(D|G|S)*]L in light-path notation [Heckbert90]. At each bounce one point of a
/// light is looked at (next-event estimation) and one direction followed; what both can find is
/// weighted by the power heuristic, exponent 2 [Veach95]. At an ideal mirror or glass (S) a direction
/// is followed only, and a light that it meets counts whole. Paths of little throughput end by
/// Russian roulette, unbiased. With most_bounces = 1 it is direct lighting.
///
/// Paths of a tile go on together, bounce by bounce, so that their rays fill packets.

namespace haarlight::render {

struct PathOptions {
  int most_bounces = 64;  ///< a longer path's light is left out: a bias
  int sure_bounces = 4;   ///< before roulette begins
  SamplerKind sampler = SamplerKind::sobol;
  std::uint64_t seed = 0;
};

class PathIntegrator final : public TileRenderer {
 public:
  /// Keeps references to the scene and its ray caster.
  PathIntegrator(const Scene& scene, const RayCaster& caster, CameraModel camera,
                 const PathOptions& options);

  std::uint64_t render_tile(const Tile& tile, SampleRange samples, Film& film) const override;

 private:
  struct Path;
  struct Batch;
  void start(const Tile& tile, std::uint32_t sample, Batch& batch) const;
  void shade(std::uint32_t sample, int bounce, Batch& batch) const;

  const Scene* scene_;
  const RayCaster* caster_;
  CameraModel camera_;
  PathOptions options_;
  MeshLights lights_;
};

}  // namespace haarlight::render
