// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/camera/camera.h"
#include "render/film/filter.h"
#include "render/light/emission.h"
#include "render/light/scene_lights.h"
#include "render/loop/tile_renderer.h"
#include "render/sampling/sampler.h"
#include "render/surface/path_vertex.h"

/// @file
/// Bidirectional path tracing [Lafortune93], [Veach97] chapter 10: E[(D|G|S)*]L in light-path notation
/// [Heckbert90]. Each sample follows a path from the camera and one from a light, and connects each
/// vertex of the one with each of the other. A path with s vertices on the light's side and t on the
/// camera's is found by strategy (s, t):
///
///     s = 0            the camera's path meets a light
///     s = 1            a point of a light is asked for, as in path tracing
///     s >= 2, t >= 2   both paths go on to the vertices that are connected
///     t = 1, s >= 2    a vertex of the light's path is seen by the camera: a splat on the film
///
/// Light that comes straight to the camera is found by s = 0 alone. Each counts by the power heuristic,
/// exponent 2, over all strategies for that path; the sums of the others' densities are kept along
/// the paths [Georgiev12], so that a connection costs the same however long they are. Roulette is
/// not in these weights: they are functions of the path alone, and any that sum to 1 are right.
///
/// An orthographic camera has no t = 1: no connection has just its direction.

namespace haarlight::render {

/// One of the ways to find a path.
struct PathStrategy {
  int light_vertices = 0;   ///< s
  int camera_vertices = 2;  ///< t, with that on the lens

  friend bool operator==(const PathStrategy&, const PathStrategy&) = default;
};

struct BidirectionalOptions {
  int most_bounces = 64;                   ///< a longer path's light is left out: a bias
  int sure_bounces = 2;                    ///< of each side, before roulette begins
  LightChoice lights = LightChoice::tree;  ///< for s = 1; not `all`
  SamplerKind sampler = SamplerKind::sobol;
  std::uint64_t seed = 0;
  FilterKind filter = FilterKind::box;
  bool has_features = false;  ///< fills the layers after the first
  int first_x = 0;  ///< pixel of the camera that the film's first is: a crop of its picture
  int first_y = 0;
  int width = 0;  ///< of the film: where splats go, and how many paths start at the lights
  int height = 0;
  /// Fills SurfaceLayer::path_tracing(), too, for a pilot.
  bool tells_of_path_tracing = false;
  /// Adds only what it finds, with weight 1: to compare strategies with each other.
  std::optional<PathStrategy> only;
};

class BidirectionalIntegrator final : public TileRenderer {
 public:
  /// Keeps references to all but the camera.
  /// @param environment  of the scene's source; nothing: the scene has none
  BidirectionalIntegrator(const Scene& scene, const RayCaster& caster,
                          const Environment* environment, Camera camera,
                          const BidirectionalOptions& options);

  /// Fills surface_layers() with splats.
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

 private:
  struct Path;
  struct Walk;
  struct Front;
  struct LightVertex;
  struct Connection;
  struct Batch;
  struct Met;
  struct PathTracingDensities;

  void start_paths(const Tile& rows, Batch& batch) const;
  void start_from_lights(std::uint32_t sample, Batch& batch) const;
  void start_from_camera(std::uint32_t sample, Batch& batch) const;
  void follow_lights(std::uint32_t sample, Batch& batch) const;
  void follow_camera(std::uint32_t sample, FilmTile& tile, Batch& batch) const;
  bool leave_light(const Met& met, Walk& walk, const Batch& batch) const;
  void see_from_camera(const LightVertex& vertex, int depth, Batch& batch) const;
  void add_emission(const Met& met, int bounce, const Walk& walk, Batch& batch) const;
  void add_met_light(const Eigen::Vector3d& light, double asked, double traced,
                     Path& path) const;
  void add_environment(const Ray& ray, int bounce, const Walk& walk, Batch& batch) const;
  void ask_light(const PathVertex& vertex, int bounce, const Walk& walk,
                 const Eigen::Vector2d& square, Batch& batch) const;
  void connect(const PathVertex& vertex, int bounce, const Walk& walk, Batch& batch) const;
  bool scatter(std::uint32_t sample, std::uint32_t dimension, bool is_from_light, int bounce,
               const Met& met, const PathVertex* vertex, Batch& batch, Walk& walk,
               Ray& onward) const;
  void settle(std::uint32_t sample, Batch& batch, FilmTile& tile) const;
  double add_splat(const Connection& connection, const Eigen::Vector3d& value,
                   FilmTile& tile) const;
  [[nodiscard]] bool counts(int light_vertices, int camera_vertices) const;
  [[nodiscard]] double weight(double others) const;
  [[nodiscard]] Eigen::Vector2d told_of_path_tracing(const Eigen::Vector3d& value,
                                                     double weight,
                                                     double by_path_tracing) const;
  [[nodiscard]] double asked_from(std::size_t light, const LitPoint& from, double offset_mm,
                                  const LightHit& hit) const;

  const Scene* scene_;
  const RayCaster* caster_;
  Camera camera_;
  BidirectionalOptions options_;
  PixelFilter filter_;
  SceneLights lights_;
  Emitters emitters_;
  std::vector<double>
      light_offsets_;     ///< by light: RayCaster::most_offset_mm(); of no surface 0
  double n_light_paths_;  ///< for each sample of a pixel
};

}  // namespace haarlight::render
