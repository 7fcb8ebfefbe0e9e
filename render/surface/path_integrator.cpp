// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_integrator.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "haarlight/core/error.h"
#include "render/bsdf/bsdf.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"
#include "render/surface/specular_direction.h"
#include "render/surface/surface_layers.h"
#include "render/surface/vertex_lanes.h"

namespace haarlight::render {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// Dimensions of a sample: the pixel's, then those of each bounce.
constexpr std::uint32_t kPixelDimension = 0;
constexpr std::uint32_t kLensDimension = 1;
constexpr std::uint32_t kFirstBounce = 2;
enum BounceDimension : std::uint32_t { light_point, lobe, direction_to_go, roulette };
constexpr std::uint32_t kPerBounce = 8;  // some of them for later
constexpr std::uint32_t dimension_of(int bounce, BounceDimension which) {
  return kFirstBounce + kPerBounce * static_cast<std::uint32_t>(bounce) + which;
}
constexpr std::uint32_t kAllLights = 1U << 24U;  // of each light in turn, where all are asked

constexpr std::size_t kMostShadowRays = 1U << 14U;  // that wait to be cast

}  // namespace

struct PathIntegrator::Path {
  PixelSamples numbers;
  int x;
  int y;
  double weight;  ///< of its sample, by the pixel's filter
  Vector3d throughput = Vector3d::Ones();
  Vector3d radiance = Vector3d::Zero();
  double density = std::numeric_limits<double>::infinity();  ///< of its last direction; a
      ///< camera's, a delta lobe's is certain
  double radiance_scale = 1.0;  ///< of the throughput: what refraction is yet to undo
  LitPoint from;                ///< where its last direction was drawn
  double from_offset = 0.0;     ///< of the ray that left there, mm
  bool asks_cache = true;       ///< until a near-diffuse surface has no irradiance in it
  bool counts_lights = true;    ///< that it meets; else a surface comes first that scatters
  /// Of the throughput what goes on at the next surface that is no ideal mirror or glass: less than
  /// 1 where an irradiance cache has told the rest.
  Vector3d beyond = Vector3d::Ones();
};

/// Of vertices that are shaded one after the other, what is computed in vectors.
struct PathIntegrator::Block {
  std::array<Hit, kLanes> surfaces;
  VertexLanes vertices;
  LightLanes lights;
  // Where one light is chosen:
  std::array<bool, kLanes> has_light;
  std::array<bool, kLanes> is_drawn;  ///< its point is among the `lights`
  std::array<ChosenLight, kLanes> chosen;
};

/// Where a path meets a surface.
struct PathIntegrator::Vertex {
  int path;            ///< of the batch
  std::size_t number;  ///< of those that go on: of their random numbers
  const Ray& ray;
  const Hit& hit;
  const Block& block;
  std::size_t lane;

  [[nodiscard]] Vector3d to_eye() const { return block.vertices.to_eye[lane]; }  ///< local
  [[nodiscard]] Vector3d local(const Vector3d& world) const {
    return {block.vertices.first[lane].dot(world), block.vertices.second[lane].dot(world),
            block.vertices.normal[lane].dot(world)};
  }
  [[nodiscard]] Vector3d world(const Vector3d& local) const {
    return local.x() * block.vertices.first[lane] + local.y() * block.vertices.second[lane] +
           local.z() * block.vertices.normal[lane];
  }
};

struct PathIntegrator::Batch {
  Block block{};  ///< lanes without a vertex keep an earlier one's numbers, or 0
  std::vector<PixelSamples> pixels;  ///< of the tile, in the order of the paths
  std::vector<Vector2d> pixel_squares;
  std::vector<Path> paths;
  // Of those that go on:
  std::vector<int> active;
  std::vector<Ray> rays;
  std::vector<RawHit> hits;
  std::vector<PixelSamples> numbers;
  std::vector<Vector2d> light_squares;  ///< their numbers at this bounce
  std::vector<Vector2d> direction_squares;
  // Towards lights:
  std::vector<Ray> shadow_rays;
  std::vector<int> lit;  ///< which path
  std::vector<Vector3d> light;
  std::vector<std::uint8_t> blocked;
  std::uint64_t n_rays = 0;
};

PathIntegrator::PathIntegrator(const Scene& scene, const RayCaster& caster,
                               const Environment* environment, Camera camera,
                               const PathOptions& options)
    : scene_(&scene),
      caster_(&caster),
      camera_(std::move(camera)),
      options_(options),
      filter_(options.filter),
      lights_(scene, environment, caster.scene_radius_mm(), options.lights,
              options.also.has(PathTerm::light_choice)) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0 && options.sure_bounces >= 0,
                    "bounces are counted from 0");
  has_specular_ = std::ranges::any_of(scene.materials, [](const Material& material) {
    return material.bsdf == BsdfKind::mirror || material.bsdf == BsdfKind::dielectric;
  });
  meets_lights_ = lights_.is_any_met() || options.also.has(PathTerm::met_lights);
  is_alone_ = !options.also.has(PathTerm::self_rays) && is_alone_and_convex(scene);
  draws_lens_ = camera_.has_lens() || options.also.has(PathTerm::lens_points);
  asks_lights_ = lights_.size() > 0 && options.sampling != DirectSampling::bsdf;
  for (std::size_t light = 0; light < lights_.size(); ++light) {
    const std::optional<std::uint32_t> surface = lights_.surface_of(light);
    light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
  }
  follows_to_lights_ = meets_lights_ && (options.sampling != DirectSampling::light ||
                                         options.also.has(PathTerm::met_lights));
}

PathTerms PathIntegrator::terms() const {
  PathTerms terms;
  const auto add = [&terms](PathTerm term, bool is_needed) {
    if (is_needed) {
      terms.add(term);
    }
  };
  add(PathTerm::self_rays, !is_alone_and_convex(*scene_));
  add(PathTerm::met_lights, lights_.is_any_met() && options_.sampling != DirectSampling::light);
  add(PathTerm::light_choice, lights_.size() > 1 && options_.lights != LightChoice::all &&
                                  options_.sampling != DirectSampling::bsdf);
  add(PathTerm::lobe_choice,
      std::ranges::any_of(scene_->materials, [](const Material& material) {
        return material.bsdf == BsdfKind::dielectric || material.bsdf == BsdfKind::coated ||
               (material.bsdf == BsdfKind::blinn_phong && material.ks > 0.0);
      }));
  add(PathTerm::lens_points, camera_.has_lens());
  add(PathTerm::feature_channels, options_.has_features);
  return terms;
}

/// Whether no ray from there on its side meets a surface: none is cast.
bool PathIntegrator::sees_nothing(const Hit& hit) const { return is_alone_ && hit.is_front; }

void PathIntegrator::start(const Tile& tile, std::uint32_t sample, Batch& batch) const {
  batch.paths.clear();
  batch.active.clear();
  if (batch.pixels.empty()) {
    for (int y = tile.y0; y < tile.y1; ++y) {
      for (int x = tile.x0; x < tile.x1; ++x) {
        batch.pixels.emplace_back(options_.sampler, options_.seed, x + options_.first_x,
                                  y + options_.first_y);
      }
    }
  }
  batch.pixel_squares.resize(batch.pixels.size());
  batch.rays.resize(batch.pixels.size());
  PixelSamples::two(batch.pixels, sample, kPixelDimension, batch.pixel_squares);
  std::size_t i = 0;
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x, ++i) {
      const PixelSamples& numbers = batch.pixels[i];
      const PixelFilter::Sample at = filter_.sample(batch.pixel_squares[i]);
      const Vector2d lens =
          draws_lens_ ? numbers.two(sample, kLensDimension) : Vector2d::Zero();
      batch.active.push_back(static_cast<int>(i));
      batch.paths.push_back({.numbers = numbers, .x = x, .y = y, .weight = at.weight});
      const int camera_x = x + options_.first_x;
      const int camera_y = y + options_.first_y;
      batch.rays[i] =
          camera_.ray(camera_x + 0.5 + at.offset.x(), camera_y + 0.5 + at.offset.y(), lens);
    }
  }
}

/// Of light that a direction has met and that could have been asked instead.
double PathIntegrator::met_weight(const Path& path, std::size_t light,
                                  const LightHit& hit) const {
  if (std::isinf(path.density) || options_.sampling == DirectSampling::bsdf) {
    return 1.0;
  }
  if (options_.sampling == DirectSampling::light) {
    return 0.0;
  }
  const double asked = hit.distance_mm > nearest_asked(path.from_offset, light_offsets_[light])
                           ? lights_.probability(light, path.from) *
                                 density(lights_[light], path.from.point, hit)
                           : 0.0;
  return power_heuristic(path.density, asked);
}

void PathIntegrator::add_emission(const Ray& ray, const Hit& hit, Path& path) const {
  const auto surface = static_cast<std::uint32_t>(hit.mesh);
  const std::optional<std::size_t> light = lights_.of_surface(surface);
  if (!light || !hit.is_front || !path.counts_lights) {
    return;
  }
  const LightHit met{.direction = ray.direction,
                     .distance_mm = hit.distance_mm,
                     .cosine = -hit.flat_normal.dot(ray.direction)};
  path.radiance += met_weight(path, *light, met) *
                   path.throughput.cwiseProduct(lights_.radiance_of_surface(surface));
}

void PathIntegrator::add_environment(const Ray& ray, Path& path) const {
  if (const std::optional<std::size_t> light = lights_.environment();
      light && path.counts_lights) {
    const LightHit met{.direction = ray.direction,
                       .distance_mm = std::numeric_limits<double>::infinity(),
                       .cosine = 1.0};
    const auto& environment = std::get<EnvironmentSourceLight>(lights_[*light]);
    path.radiance += met_weight(path, *light, met) *
                     path.throughput.cwiseProduct(environment.light.radiance(ray.direction));
  }
}

/// Puts a ray towards a light among those that wait, unless nothing could arrive.
/// @param to_light    the sample's direction in the vertex's frame
/// @param find_scale  () -> cosine over density, with the heuristic's weight
/// @param put_ray     (Ray&): the ray to cast
template <class Kind, class FindScale, class PutRay>
[[gnu::always_inline]] inline void PathIntegrator::ask_along(
    const Vector3d& to_light, const Vector3d& radiance, const FindScale& find_scale,
    const PutRay& put_ray, const Kind& bsdf, const Vertex& vertex, Batch& batch) const {
  const Vector3d f = bsdf.evaluate(vertex.to_eye(), to_light);
  if (!(f.maxCoeff() > 0.0)) {
    return;
  }
  Path& path = batch.paths[static_cast<std::size_t>(vertex.path)];
  const Vector3d arrives =
      find_scale() * path.throughput.cwiseProduct(f).cwiseProduct(radiance);
  if (sees_nothing(vertex.hit)) {
    path.radiance += arrives;
    return;
  }
  put_ray(batch.shadow_rays.emplace_back());
  batch.lit.push_back(vertex.path);
  batch.light.push_back(arrives);
  if (batch.shadow_rays.size() >= kMostShadowRays) {
    add_unblocked(batch);
  }
}

/// The cosine at the vertex over the density of the light's point, with the heuristic's weight.
/// @param density  per sr
template <class Kind>
double PathIntegrator::light_scale(const ChosenLight& chosen, double density, bool is_delta,
                                   const Vector3d& to_light, const Kind& bsdf,
                                   const Vertex& vertex) const {
  const double asked = chosen.probability * density;
  double weight = 1.0;
  if (options_.sampling == DirectSampling::mis && !is_delta && lights_.is_met(chosen.index)) {
    weight = power_heuristic(asked, bsdf.density(vertex.to_eye(), to_light));
  }
  return weight * to_light.z() / asked;
}

template <class Kind>
void PathIntegrator::ask(const ChosenLight& chosen, const Kind& bsdf, const Vertex& vertex,
                         Batch& batch) const {
  const LightSample light =
      render::sample(lights_[chosen.index], vertex.hit.point, chosen.square);
  const double light_offset = light_offsets_[chosen.index];
  if (light.is_found && light.distance_mm > nearest_asked(vertex.hit.offset_mm, light_offset) &&
      vertex.hit.flat_normal.dot(light.direction) > 0.0) {
    const Vector3d to_light = vertex.local(light.direction);
    ask_along(
        to_light, light.radiance,
        [&] {
          return light_scale(chosen, light.density, light.is_delta, to_light, bsdf, vertex);
        },
        [&](Ray& ray) { ray = light_ray(vertex.hit, light, light_offset); }, bsdf, vertex,
        batch);
  }
}

/// The light that has been chosen for the vertex, if any.
template <class Kind>
void PathIntegrator::ask_chosen(const Kind& bsdf, const Vertex& vertex, Batch& batch) const {
  const std::size_t lane = vertex.lane;
  const Block& block = vertex.block;
  if (!block.has_light[lane]) {
    return;
  }
  const ChosenLight& chosen = block.chosen[lane];
  if (!block.is_drawn[lane]) {
    ask(chosen, bsdf, vertex, batch);
    return;
  }
  const LightLanes& lights = block.lights;
  const double distance = lights.distance[lane];
  if (lights.towards[lane] > 0.0 && lights.height[lane] > 0.0 &&
      distance > nearest_asked(vertex.hit.offset_mm, light_offsets_[chosen.index])) {
    const Vector3d to_light = lights.local[lane];
    ask_along(
        to_light, area_radiance(lights_[chosen.index], lights.towards[lane] / distance),
        [&] {
          if constexpr (std::is_same_v<Kind, Lambert>) {
            return lights.cosine_scale[lane];
          } else {
            return light_scale(chosen, lights.density[lane], false, to_light, bsdf, vertex);
          }
        },
        [&](Ray& ray) {
          ray.origin = lights.ray_origin[lane];
          ray.direction = lights.ray_direction[lane];
          ray.t_max = 1.0;
        },
        bsdf, vertex, batch);
  }
}

template <class Kind>
void PathIntegrator::ask_all(std::uint32_t sample, int bounce, const Kind& bsdf,
                             const Vertex& vertex, Batch& batch) const {
  const PixelSamples& numbers = batch.paths[static_cast<std::size_t>(vertex.path)].numbers;
  const auto nth_bounce = static_cast<std::uint32_t>(bounce);
  const auto n_lights = static_cast<std::uint32_t>(lights_.size());
  for (std::uint32_t i = 0; i < n_lights; ++i) {
    ask({.index = i,
         .probability = 1.0,
         .square = numbers.two(sample, kAllLights + nth_bounce * n_lights + i)},
        bsdf, vertex, batch);
  }
}

/// Casts the rays that wait towards lights, and adds the light of those that arrive.
void PathIntegrator::add_unblocked(Batch& batch) const {
  batch.blocked.resize(batch.shadow_rays.size());
  caster_->are_blocked(batch.shadow_rays, RayOrder::scattered, batch.blocked);
  batch.n_rays += batch.shadow_rays.size();
  for (std::size_t i = 0; i < batch.lit.size(); ++i) {
    if (batch.blocked[i] == 0) {
      batch.paths[static_cast<std::size_t>(batch.lit[i])].radiance += batch.light[i];
    }
  }
  batch.shadow_rays.clear();
  batch.lit.clear();
  batch.light.clear();
}

/// The numbers of all paths for their next directions and lights.
void PathIntegrator::draw_numbers(std::uint32_t sample, int bounce, Batch& batch) const {
  const auto draw = [&](BounceDimension which, std::vector<Vector2d>& squares) {
    squares.resize(batch.active.size());
    PixelSamples::two(batch.numbers, sample, dimension_of(bounce, which), squares);
  };
  batch.numbers.clear();
  for (const int path : batch.active) {
    batch.numbers.push_back(batch.paths[static_cast<std::size_t>(path)].numbers);
  }
  if (bounce < options_.most_bounces) {
    draw(direction_to_go, batch.direction_squares);
    if (asks_lights_ && options_.lights != LightChoice::all) {
      draw(light_point, batch.light_squares);
    }
  }
}

/// Adds what the surface's near-diffuse part reflects of the irradiance that the cache has there:
/// rho_hd E / pi. (Slide 92 of [Chuang07] has E times half of rho: that is pi/2 times as much.)
/// @return whether the cache has it
template <class Kind>
bool PathIntegrator::read_cache(const Kind& bsdf, const Vertex& vertex, Path& path) const {
  const Vector3d rho = bsdf.near_diffuse_albedo(vertex.to_eye());
  if (rho.isZero(0.0)) {
    return false;
  }
  const std::optional<Vector3d> irradiance =
      options_.cache->irradiance(vertex.hit.point, vertex.block.vertices.normal[vertex.lane]);
  if (!irradiance) {
    path.asks_cache = false;
    return false;
  }
  path.radiance +=
      std::numbers::inv_pi * path.throughput.cwiseProduct(rho).cwiseProduct(*irradiance);
  return true;
}

/// Asks lights, and draws the direction in which the path goes on.
/// @return whether it does: `onward`
template <class Kind>
bool PathIntegrator::scatter(std::uint32_t sample, int bounce, const Kind& bsdf,
                             const Vertex& vertex, Batch& batch, Ray& onward) const {
  if (bsdf.is_black()) {
    return false;
  }
  const Hit& hit = vertex.hit;
  Path& path = batch.paths[static_cast<std::size_t>(vertex.path)];
  bool is_cached = false;
  if constexpr (!kIsSpecular<Kind>) {
    path.counts_lights = true;
    if (options_.cache != nullptr) {
      path.throughput =
          path.throughput.cwiseProduct(std::exchange(path.beyond, Vector3d::Ones()));
      if (path.throughput.isZero(0.0)) {
        return false;
      }
    }
    if (asks_lights_ && options_.lights == LightChoice::all) {
      ask_all(sample, bounce, bsdf, vertex, batch);
    } else if (asks_lights_) {
      ask_chosen(bsdf, vertex, batch);
    }
    if constexpr (kHasNearDiffusePart<Kind>) {
      is_cached =
          options_.cache != nullptr && path.asks_cache && read_cache(bsdf, vertex, path);
      if (is_cached && !kHasLobes<Kind> && !follows_to_lights_ &&
          !(has_specular_ && meets_lights_)) {
        return false;  // what it met would be in the cache
      }
    }
  }
  const double which_lobe = kHasLobes<Kind> || options_.also.has(PathTerm::lobe_choice)
                                ? path.numbers.one(sample, dimension_of(bounce, lobe))
                                : 0.0;
  BsdfSample next;
  Vector3d direction;
  if constexpr (std::is_same_v<Kind, Lambert>) {
    next = bsdf.sample(vertex.to_eye(), vertex.block.vertices.cosine_local[vertex.lane]);
    direction = vertex.block.vertices.cosine_world[vertex.lane];
  } else {
    next = bsdf.sample(vertex.to_eye(), which_lobe, batch.direction_squares[vertex.number]);
    direction = vertex.world(next.to_light);
  }
  if constexpr (kIsSpecular<Kind>) {
    mend_specular(bsdf, vertex.ray, hit, vertex.to_eye(), which_lobe,
                  batch.direction_squares[vertex.number], next, direction);
  }
  if (!next.is_found || !is_on_its_side(hit, next, direction)) {
    return false;
  }
  // The last direction can only meet a light.
  if (bounce + 1 == options_.most_bounces &&
      !(next.is_delta ? meets_lights_ : follows_to_lights_)) {
    return false;
  }
  if constexpr (kHasNearDiffusePart<Kind>) {
    if (is_cached) {
      const Vector3d all = bsdf.evaluate(vertex.to_eye(), next.to_light);
      const Vector3d glossy = bsdf.glossy(vertex.to_eye(), next.to_light);
      path.beyond = (all.array() > 0.0).select(glossy.array() / all.array(), 0.0);
    }
  }
  path.throughput = path.throughput.cwiseProduct(next.weight);
  path.density = next.is_delta ? std::numeric_limits<double>::infinity() : next.density;
  path.radiance_scale *= next.radiance_scale;
  if (bounce >= options_.sure_bounces) {
    const double survives = std::min(1.0, path.throughput.maxCoeff() / path.radiance_scale);
    if (!(path.numbers.one(sample, dimension_of(bounce, roulette)) < survives)) {
      return false;
    }
    path.throughput /= survives;
  }
  path.from = {.point = hit.point, .normal = hit.flat_normal};
  path.from_offset = hit.offset_mm;
  const double side = next.is_transmission ? -hit.offset_mm : hit.offset_mm;
  onward.origin = hit.point + side * hit.flat_normal;
  onward.direction = direction;
  onward.t_min = 0.0;
  onward.t_max = std::numeric_limits<double>::infinity();
  return true;
}

/// Frames, directions and lights of the vertices from `begin` on. Each loop is short, so that the
/// processor has many of its turns at work at once.
void PathIntegrator::fill(const Batch& batch, std::size_t begin, std::size_t n,
                          Block& block) const {
  for (std::size_t lane = 0; lane < n; ++lane) {
    if (batch.hits[begin + lane].is_hit()) {
      const Vector3d& direction = batch.rays[begin + lane].direction;
      block.vertices.put(lane, shading_normal(block.surfaces[lane], direction), direction,
                         batch.direction_squares[begin + lane]);
    }
  }
  block.vertices.find(n);
  if (!asks_lights_ || options_.lights == LightChoice::all) {
    return;
  }
  for (std::size_t lane = 0; lane < n; ++lane) {
    const Hit& hit = block.surfaces[lane];
    block.has_light[lane] = false;
    block.is_drawn[lane] = false;
    if (!batch.hits[begin + lane].is_hit() || scatters_delta_only(*scene_, hit)) {
      continue;
    }
    if (const std::optional<ChosenLight> chosen =
            lights_.choose({.point = hit.point, .normal = hit.flat_normal},
                           batch.light_squares[begin + lane])) {
      block.has_light[lane] = true;
      block.chosen[lane] = *chosen;
    }
  }
  for (std::size_t lane = 0; lane < n; ++lane) {
    if (!block.has_light[lane]) {
      continue;
    }
    const ChosenLight& chosen = block.chosen[lane];
    const AreaPoint drawn = draw(lights_[chosen.index], chosen.square);
    block.is_drawn[lane] = drawn.density_per_mm2 > 0.0;
    if (block.is_drawn[lane]) {
      const bool is_met = lights_.is_met(chosen.index);
      block.lights.put(lane, block.surfaces[lane], drawn, chosen.probability,
                       is_met && options_.sampling == DirectSampling::mis,
                       light_offsets_[chosen.index], is_met);
    }
  }
  block.lights.find(n, block.vertices);
}

/// Adds the light of what the rays hit, and finds the next rays and those towards lights.
void PathIntegrator::shade(std::uint32_t sample, int bounce, Batch& batch) const {
  const bool is_last = bounce == options_.most_bounces;
  draw_numbers(sample, bounce, batch);
  std::size_t n_active = 0;
  Block& block = batch.block;
  for (std::size_t begin = 0; begin < batch.active.size(); begin += kLanes) {
    const std::size_t n = std::min(kLanes, batch.active.size() - begin);
    caster_->surfaces_at(std::span(batch.rays).subspan(begin, n),
                         std::span(batch.hits).subspan(begin, n),
                         std::span(block.surfaces).first(n));
    if (!is_last) {
      fill(batch, begin, n, block);
    }
    for (std::size_t lane = 0; lane < n; ++lane) {
      const std::size_t i = begin + lane;
      Path& path = batch.paths[static_cast<std::size_t>(batch.active[i])];
      const Ray& ray = batch.rays[i];
      if (!batch.hits[i].is_hit()) {
        add_environment(ray, path);
        continue;
      }
      const Hit& hit = block.surfaces[lane];
      add_emission(ray, hit, path);
      if (is_last) {
        continue;
      }
      const Vertex vertex{.path = batch.active[i],
                          .number = i,
                          .ray = ray,
                          .hit = hit,
                          .block = block,
                          .lane = lane};
      Ray& onward = batch.rays[n_active];  // an earlier one, or its own
      const bool goes_on = std::visit(
          [&](const auto& bsdf) {
            return scatter(sample, bounce, bsdf, vertex, batch, onward);
          },
          bsdf_of(*scene_, hit));
      if (!goes_on) {
        continue;
      }
      if (sees_nothing(hit)) {
        add_environment(onward, path);
        continue;
      }
      batch.active[n_active] = batch.active[i];
      ++n_active;
    }
  }
  batch.active.resize(n_active);
  batch.rays.resize(n_active);
}

std::uint64_t PathIntegrator::gather(std::uint32_t sample,
                                     std::span<const PixelSamples> numbers,
                                     std::span<const Ray> rays,
                                     std::span<Gathered> found) const {
  HAARLIGHT_EXPECTS(numbers.size() == rays.size() && found.size() == rays.size(),
                    "an answer for each ray");
  Batch batch;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    batch.paths.push_back(
        {.numbers = numbers[i], .x = 0, .y = 0, .weight = 1.0, .counts_lights = false});
    batch.active.push_back(static_cast<int>(i));
    batch.rays.push_back(rays[i]);
  }
  for (int bounce = 1; bounce <= options_.most_bounces && !batch.active.empty(); ++bounce) {
    batch.hits.resize(batch.rays.size());
    caster_->intersect(batch.rays, RayOrder::scattered, batch.hits);
    batch.n_rays += batch.rays.size();
    if (bounce == 1) {
      for (std::size_t i = 0; i < rays.size(); ++i) {
        found[i].distance_mm = batch.hits[i].is_hit() ? double{batch.hits[i].t}
                                                      : std::numeric_limits<double>::infinity();
      }
    }
    shade(sample, bounce, batch);
    add_unblocked(batch);
  }
  for (std::size_t i = 0; i < rays.size(); ++i) {
    found[i].radiance = batch.paths[i].radiance;
  }
  return batch.n_rays;
}

std::uint64_t PathIntegrator::render_tile(SampleRange samples, FilmTile& tile) const {
  Batch batch;
  for (std::uint32_t sample = samples.first; sample < samples.end; ++sample) {
    start(tile.area(), sample, batch);
    for (int bounce = 0; !batch.active.empty(); ++bounce) {
      batch.hits.resize(batch.rays.size());
      caster_->intersect(batch.rays, bounce == 0 ? RayOrder::coherent : RayOrder::scattered,
                         batch.hits);
      batch.n_rays += batch.rays.size();
      if (bounce == 0 && options_.has_features) {
        for (std::size_t i = 0; i < batch.active.size(); ++i) {
          if (batch.hits[i].is_hit()) {
            const Path& path = batch.paths[static_cast<std::size_t>(batch.active[i])];
            add_features(*scene_, batch.rays[i],
                         caster_->surface_at(batch.rays[i], batch.hits[i]), camera_.axis(),
                         path.weight, path.x, path.y, tile);
          }
        }
      }
      shade(sample, bounce, batch);
      add_unblocked(batch);
    }
    for (const Path& path : batch.paths) {
      tile.add(path.x, path.y, SurfaceLayer::kRadiance, (path.weight * path.radiance).eval());
    }
  }
  return batch.n_rays;
}

}  // namespace haarlight::render
