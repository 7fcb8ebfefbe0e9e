// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_integrator.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "haarlight/core/error.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"

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

/// The weight of a density against another that could have found the same [Veach95], eq. (14)
/// with exponent 2. Neither is squared: that would overflow at 1e155.
double power_heuristic(double own, double other) {
  if (!(own > 0.0)) {
    return 0.0;
  }
  const double ratio = other / own;
  return 1.0 / (1.0 + ratio * ratio);
}

/// No nearer point of a light is asked: its ray would be shorter than its two offsets, and the first
/// changes what arrives. @param offset, light_offset  mm, of the point and of the light's
double nearest_asked(double offset, double light_offset) { return 2.0 * offset + light_offset; }

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
};

/// Where a path meets a surface.
struct PathIntegrator::Vertex {
  int path;  ///< of the batch
  const Ray& ray;
  const Hit& hit;
  Bsdf bsdf;
  Matrix3d world_from_local;
  Vector3d to_eye;  ///< local
};

struct PathIntegrator::Batch {
  std::vector<Path> paths;
  // Of those that go on:
  std::vector<int> active;
  std::vector<Ray> rays;
  std::vector<RawHit> hits;
  std::vector<Hit> surfaces;  ///< of the hits
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
  meets_lights_ = lights_.is_any_met() || options.also.has(PathTerm::met_lights);
  is_alone_ = !options.also.has(PathTerm::self_rays) && is_alone_and_convex(scene);
  draws_lens_ = camera_.has_lens() || options.also.has(PathTerm::lens_points);
  asks_lights_ = lights_.size() > 0 && options.sampling != DirectSampling::bsdf;
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
  batch.rays.clear();
  for (int y = tile.y0; y < tile.y1; ++y) {
    for (int x = tile.x0; x < tile.x1; ++x) {
      const int camera_x = x + options_.first_x;
      const int camera_y = y + options_.first_y;
      const PixelSamples numbers(options_.sampler, options_.seed, camera_x, camera_y);
      const PixelFilter::Sample at = filter_.sample(numbers.two(sample, kPixelDimension));
      const Vector2d lens =
          draws_lens_ ? numbers.two(sample, kLensDimension) : Vector2d::Zero();
      batch.active.push_back(static_cast<int>(batch.paths.size()));
      batch.paths.push_back({.numbers = numbers, .x = x, .y = y, .weight = at.weight});
      batch.rays.push_back(
          camera_.ray(camera_x + 0.5 + at.offset.x(), camera_y + 0.5 + at.offset.y(), lens));
    }
  }
}

/// Of light that a direction has met and that could have been asked instead.
double PathIntegrator::met_weight(const Path& path, std::size_t light, const LightHit& hit,
                                  double offset_mm) const {
  if (std::isinf(path.density) || options_.sampling == DirectSampling::bsdf) {
    return 1.0;
  }
  if (options_.sampling == DirectSampling::light) {
    return 0.0;
  }
  const double asked = hit.distance_mm > nearest_asked(path.from_offset, offset_mm)
                           ? lights_.probability(light, path.from) *
                                 density(lights_[light], path.from.point, hit)
                           : 0.0;
  return power_heuristic(path.density, asked);
}

void PathIntegrator::add_emission(const Vertex& vertex, Path& path) const {
  const Hit& hit = vertex.hit;
  const auto surface = static_cast<std::uint32_t>(hit.mesh);
  const std::optional<std::size_t> light = lights_.of_surface(surface);
  if (!light || !hit.is_front) {
    return;
  }
  const LightHit met{.direction = vertex.ray.direction,
                     .distance_mm = hit.distance_mm,
                     .cosine = -hit.flat_normal.dot(vertex.ray.direction)};
  path.radiance += met_weight(path, *light, met, hit.offset_mm) *
                   path.throughput.cwiseProduct(lights_.radiance_of_surface(surface));
}

void PathIntegrator::add_environment(const Ray& ray, Path& path) const {
  if (const std::optional<std::size_t> light = lights_.environment()) {
    const LightHit met{.direction = ray.direction,
                       .distance_mm = std::numeric_limits<double>::infinity(),
                       .cosine = 1.0};
    const auto& environment = std::get<EnvironmentSourceLight>(lights_[*light]);
    path.radiance += met_weight(path, *light, met, 0.0) *
                     path.throughput.cwiseProduct(environment.light.radiance(ray.direction));
  }
}

/// Puts a ray towards a light among those that wait, unless nothing could arrive.
void PathIntegrator::ask(const ChosenLight& chosen, const Vertex& vertex, Batch& batch) const {
  const Hit& hit = vertex.hit;
  const LightSample light = render::sample(lights_[chosen.index], hit.point, chosen.square);
  if (!light.is_found || !(hit.flat_normal.dot(light.direction) > 0.0)) {
    return;
  }
  const Vector3d on_light = hit.point + light.distance_mm * light.direction;
  const std::optional<std::uint32_t> surface = lights_.surface_of(chosen.index);
  const double light_offset =
      surface ? caster_->offset_mm(*surface, light.triangle, on_light) : 0.0;
  if (!(light.distance_mm > nearest_asked(hit.offset_mm, light_offset))) {
    return;
  }
  const Vector3d to_light = vertex.world_from_local.transpose() * light.direction;
  const Vector3d f = evaluate(vertex.bsdf, vertex.to_eye, to_light);
  if (!(f.maxCoeff() > 0.0)) {
    return;
  }
  const double asked = chosen.probability * light.density;
  double weight = 1.0;
  if (options_.sampling == DirectSampling::mis && !light.is_delta &&
      lights_.is_met(chosen.index)) {
    weight = power_heuristic(asked, density(vertex.bsdf, vertex.to_eye, to_light));
  }
  Path& path = batch.paths[static_cast<std::size_t>(vertex.path)];
  const Vector3d arrives = (weight * to_light.z() / asked) *
                           path.throughput.cwiseProduct(f).cwiseProduct(light.radiance);
  if (sees_nothing(hit)) {
    path.radiance += arrives;
    return;
  }
  const Vector3d origin = hit.point + hit.offset_mm * hit.flat_normal;
  if (std::isinf(light.distance_mm)) {
    batch.shadow_rays.push_back({.origin = origin, .direction = light.direction});
  } else {
    // To a point off the light, so that it does not hide itself where it is grazed.
    const Vector3d target = on_light + light_offset * light.normal;
    batch.shadow_rays.push_back({.origin = origin, .direction = target - origin, .t_max = 1.0});
  }
  batch.lit.push_back(vertex.path);
  batch.light.push_back(arrives);
  if (batch.shadow_rays.size() >= kMostShadowRays) {
    add_unblocked(batch);
  }
}

/// @param square  for one light, where one is chosen
void PathIntegrator::ask_lights(std::uint32_t sample, int bounce, const Vector2d& square,
                                const Vertex& vertex, Batch& batch) const {
  if (options_.lights != LightChoice::all) {
    const LitPoint at{.point = vertex.hit.point, .normal = vertex.hit.flat_normal};
    if (const std::optional<ChosenLight> chosen = lights_.choose(at, square)) {
      ask(*chosen, vertex, batch);
    }
    return;
  }
  const PixelSamples& numbers = batch.paths[static_cast<std::size_t>(vertex.path)].numbers;
  const auto nth_bounce = static_cast<std::uint32_t>(bounce);
  const auto n_lights = static_cast<std::uint32_t>(lights_.size());
  for (std::uint32_t i = 0; i < n_lights; ++i) {
    ask({.index = i,
         .probability = 1.0,
         .square = numbers.two(sample, kAllLights + nth_bounce * n_lights + i)},
        vertex, batch);
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

/// Adds the light of what the rays hit, and finds the next rays and those towards lights.
void PathIntegrator::shade(std::uint32_t sample, int bounce, Batch& batch) const {
  const bool asks_one = asks_lights_ && options_.lights != LightChoice::all;
  draw_numbers(sample, bounce, batch);
  batch.surfaces.resize(batch.hits.size());
  for (std::size_t i = 0; i < batch.hits.size(); ++i) {
    if (batch.hits[i].is_hit()) {
      batch.surfaces[i] = caster_->surface_at(batch.rays[i], batch.hits[i]);
    }
  }
  std::size_t n_active = 0;
  for (std::size_t i = 0; i < batch.active.size(); ++i) {
    Path& path = batch.paths[static_cast<std::size_t>(batch.active[i])];
    const Ray& ray = batch.rays[i];
    if (!batch.hits[i].is_hit()) {
      add_environment(ray, path);
      continue;
    }
    const Hit& hit = batch.surfaces[i];
    const Matrix3d world_from_local = shading_frame(hit, ray.direction);
    const Vertex vertex{.path = batch.active[i],
                        .ray = ray,
                        .hit = hit,
                        .bsdf = bsdf_of(*scene_, hit),
                        .world_from_local = world_from_local,
                        .to_eye = -(world_from_local.transpose() * ray.direction)};
    add_emission(vertex, path);
    if (bounce == options_.most_bounces || is_black(vertex.bsdf)) {
      continue;
    }
    if (asks_lights_ && has_smooth_part(vertex.bsdf)) {
      ask_lights(sample, bounce, asks_one ? batch.light_squares[i] : Vector2d::Zero(), vertex,
                 batch);
    }
    const double which_lobe =
        has_one_lobe(vertex.bsdf) && !options_.also.has(PathTerm::lobe_choice)
            ? 0.0
            : path.numbers.one(sample, dimension_of(bounce, lobe));
    const Vector2d& square = batch.direction_squares[i];
    BsdfSample next = render::sample(vertex.bsdf, vertex.to_eye, which_lobe, square);
    // What passes straight through is not rounded by the frame.
    Vector3d direction = next.to_light == -vertex.to_eye
                             ? ray.direction
                             : Vector3d(world_from_local * next.to_light);
    const auto is_on_its_side = [&] {
      const double height = hit.flat_normal.dot(direction);
      return next.is_transmission ? height < 0.0 : height > 0.0;
    };
    if (next.is_found && next.is_delta && !is_on_its_side()) {
      // An interpolated normal that mirrors or refracts to the wrong side of the triangle gives
      // way to the triangle's, so that no light is lost.
      const Matrix3d world_from_flat = frame_of(hit.flat_normal);
      next = render::sample(vertex.bsdf, -(world_from_flat.transpose() * ray.direction),
                            which_lobe, square);
      direction = world_from_flat * next.to_light;
    }
    if (!next.is_found || !is_on_its_side()) {
      continue;
    }
    // The last direction can only meet a light.
    if (bounce + 1 == options_.most_bounces &&
        !(next.is_delta ? meets_lights_ : follows_to_lights_)) {
      continue;
    }
    path.throughput = path.throughput.cwiseProduct(next.weight);
    path.density = next.is_delta ? std::numeric_limits<double>::infinity() : next.density;
    path.radiance_scale *= next.radiance_scale;
    if (bounce >= options_.sure_bounces) {
      const double survives = std::min(1.0, path.throughput.maxCoeff() / path.radiance_scale);
      if (!(path.numbers.one(sample, dimension_of(bounce, roulette)) < survives)) {
        continue;
      }
      path.throughput /= survives;
    }
    path.from = {.point = hit.point, .normal = hit.flat_normal};
    path.from_offset = hit.offset_mm;
    const double side = next.is_transmission ? -hit.offset_mm : hit.offset_mm;
    const Ray onward{.origin = hit.point + side * hit.flat_normal, .direction = direction};
    if (sees_nothing(hit)) {
      add_environment(onward, path);
      continue;
    }
    batch.rays[n_active] = onward;
    batch.active[n_active] = batch.active[i];
    ++n_active;
  }
  batch.active.resize(n_active);
  batch.rays.resize(n_active);
}

/// Of what the camera's rays hit.
void PathIntegrator::add_features(const Batch& batch, FilmTile& tile) const {
  const Vector3d axis = camera_.axis();
  for (std::size_t i = 0; i < batch.active.size(); ++i) {
    if (!batch.hits[i].is_hit()) {
      continue;
    }
    const Path& path = batch.paths[static_cast<std::size_t>(batch.active[i])];
    const Ray& ray = batch.rays[i];
    const Hit hit = caster_->surface_at(ray, batch.hits[i]);
    const Vector3d to_eye = -(shading_frame(hit, ray.direction).transpose() * ray.direction);
    const Vector3d reflected = render::albedo(bsdf_of(*scene_, hit), to_eye);
    const double w = path.weight;
    tile.add(path.x, path.y, PathLayer::kAlbedo, (w * reflected).eval());
    tile.add(path.x, path.y, PathLayer::kNormal, (w * hit.normal).eval());
    tile.add(path.x, path.y, PathLayer::kDepth, w * hit.distance_mm * ray.direction.dot(axis));
    tile.add(path.x, path.y, PathLayer::kCoverage, w);
  }
}

std::vector<FilmLayer> PathIntegrator::layers(bool has_features) {
  std::vector<FilmLayer> layers{{.name = "radiance", .channels = 3, .has_error = true}};
  if (has_features) {
    layers.push_back({.name = "albedo", .channels = 3});
    layers.push_back({.name = "normal", .channels = 3});
    layers.push_back({.name = "depth", .channels = 1});
    layers.push_back({.name = "coverage", .channels = 1});
  }
  return layers;
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
        add_features(batch, tile);
      }
      shade(sample, bounce, batch);
      add_unblocked(batch);
    }
    for (const Path& path : batch.paths) {
      tile.add(path.x, path.y, PathLayer::kRadiance, (path.weight * path.radiance).eval());
    }
  }
  return batch.n_rays;
}

}  // namespace haarlight::render
