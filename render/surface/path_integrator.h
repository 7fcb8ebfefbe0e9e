// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/camera/camera.h"
#include "render/film/filter.h"
#include "render/light/scene_lights.h"
#include "render/loop/tile_renderer.h"
#include "render/sampling/sampler.h"
#include "render/surface/irradiance_octree.h"
#include "render/surface/path_terms.h"

/// @file
/// Path tracing [Kajiya86]: E[(D|G|S)*]L in light-path notation [Heckbert90]. At each bounce lights are
/// asked (next-event estimation) and one direction is followed; what both can find is
/// weighted by the power heuristic, exponent 2 [Veach95]. At an ideal mirror or glass (S) a direction
/// is followed only, and a light that it meets counts whole. Paths of little throughput end by
/// Russian roulette, unbiased. With most_bounces = 1 it is direct lighting.
///
/// With an irradiance cache a path is followed beyond a near-diffuse surface only where the cache has
/// no irradiance there; else light that was reflected by something other than ideal mirrors and glass
/// on its way to the surface is read off the cache, and what comes from lights directly, or over
/// mirrors and glass alone, is found as ever.
///
/// Paths of a tile go on together, bounce by bounce, so that their rays fill packets.

namespace haarlight::render {

/// How the light that arrives at a point is found.
enum class DirectSampling : std::uint8_t {
  mis,    ///< both of the following, weighted
  light,  ///< points of lights alone: poor near large lights and at gloss
  bsdf,   ///< directions of the BSDF alone: poor for small lights, finds none without extent
};
inline constexpr auto kDirectSamplingWords =
    std::to_array<std::string_view>({"mis", "light", "bsdf"});
constexpr std::span<const std::string_view> words_of(DirectSampling) {
  return kDirectSamplingWords;
}

struct PathOptions {
  int most_bounces = 64;  ///< a longer path's light is left out: a bias
  int sure_bounces = 4;   ///< before roulette begins
  LightChoice lights = LightChoice::tree;
  DirectSampling sampling = DirectSampling::mis;
  SamplerKind sampler = SamplerKind::sobol;
  std::uint64_t seed = 0;
  FilterKind filter = FilterKind::box;
  bool has_features = false;  ///< fills the layers after the first
  int first_x = 0;  ///< pixel of the camera that the film's first is: a crop of its picture
  int first_y = 0;
  const IrradianceOctree* cache = nullptr;  ///< of indirect irradiance, kept by reference
  PathTerms
      also;  ///< computed although the scene does not need them: to measure what they cost
};

class PathIntegrator final : public TileRenderer {
 public:
  /// Keeps references to all but the camera.
  /// @param environment  of the scene's source; nothing: the scene has none
  PathIntegrator(const Scene& scene, const RayCaster& caster, const Environment* environment,
                 Camera camera, const PathOptions& options);

  /// The terms that the scene requires, whatever `also` says.
  [[nodiscard]] PathTerms terms() const;

  /// Fills surface_layers().
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

  /// What a ray that left a surface finds.
  struct Gathered {
    /// Without light that comes from a light itself, straight or over ideal mirrors and glass alone.
    Eigen::Vector3d radiance = Eigen::Vector3d::Zero();
    double distance_mm = std::numeric_limits<double>::infinity();  ///< to what it meets first
  };
  /// One estimate for each ray, by a path that goes on with its second bounce.
  /// @param numbers  (rays.size(),) @param rays  of unit direction @param found  (rays.size(),)
  /// @return rays cast
  [[nodiscard]] std::uint64_t gather(std::uint32_t sample,
                                     std::span<const PixelSamples> numbers,
                                     std::span<const Ray> rays,
                                     std::span<Gathered> found) const;

 private:
  struct Path;
  struct Block;
  struct Vertex;
  struct Batch;
  void start(const Tile& tile, std::uint32_t sample, Batch& batch) const;
  void fill(const Batch& batch, std::size_t begin, std::size_t n, Block& block) const;
  void shade(std::uint32_t sample, int bounce, Batch& batch) const;
  void add_emission(const Ray& ray, const Hit& hit, Path& path) const;
  void add_environment(const Ray& ray, Path& path) const;
  void draw_numbers(std::uint32_t sample, int bounce, Batch& batch) const;
  template <class Kind>
  bool scatter(std::uint32_t sample, int bounce, const Kind& bsdf, const Vertex& vertex,
               Batch& batch, Ray& onward) const;
  template <class Kind>
  void ask_all(std::uint32_t sample, int bounce, const Kind& bsdf, const Vertex& vertex,
               Batch& batch) const;
  template <class Kind>
  void ask_chosen(const Kind& bsdf, const Vertex& vertex, Batch& batch) const;
  template <class Kind>
  void ask(const ChosenLight& chosen, const Kind& bsdf, const Vertex& vertex,
           Batch& batch) const;
  template <class Kind, class FindScale, class PutRay>
  void ask_along(const Eigen::Vector3d& to_light, const Eigen::Vector3d& radiance,
                 const FindScale& find_scale, const PutRay& put_ray, const Kind& bsdf,
                 const Vertex& vertex, Batch& batch) const;
  template <class Kind>
  [[nodiscard]] double light_scale(const ChosenLight& chosen, double density, bool is_delta,
                                   const Eigen::Vector3d& to_light, const Kind& bsdf,
                                   const Vertex& vertex) const;
  void add_unblocked(Batch& batch) const;
  [[nodiscard]] bool sees_nothing(const Hit& hit) const;
  template <class Kind>
  [[nodiscard]] bool read_cache(const Kind& bsdf, const Vertex& vertex, Path& path) const;
  [[nodiscard]] double met_weight(const Path& path, std::size_t light,
                                  const LightHit& hit) const;

  const Scene* scene_;
  const RayCaster* caster_;
  Camera camera_;
  PathOptions options_;
  PixelFilter filter_;
  SceneLights lights_;
  std::vector<double>
      light_offsets_;  ///< by light: RayCaster::most_offset_mm(); of no surface 0
  bool asks_lights_ = false;
  bool meets_lights_ = false;       ///< some ray may meet one
  bool follows_to_lights_ = false;  ///< by a direction of a BSDF's smooth part
  bool has_specular_ = false;       ///< some material is an ideal mirror or glass
  bool is_alone_ = false;           ///< no front of a surface sees a surface
  bool draws_lens_ = false;
};

}  // namespace haarlight::render
