// SPDX-License-Identifier: Apache-2.0
#include "render/surface/bidirectional_integrator.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <type_traits>
#include <utility>
#include <variant>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/rays/ray_offset.h"
#include "render/surface/light_ray.h"
#include "render/surface/specular_direction.h"
#include "render/surface/surface_layers.h"
#include "render/surface/vertex_lanes.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Dimensions of a sample: the pixel's, the lens', the emission's; then those of each bounce, of the
// camera's path and of the light's.
constexpr std::uint32_t kPixelDimension = 0;
constexpr std::uint32_t kLensDimension = 1;
constexpr std::uint32_t kEmissionPoint = 2;
constexpr std::uint32_t kEmissionDirection = 3;
constexpr std::uint32_t kFirstBounce = 8;
constexpr std::uint32_t kFirstLightBounce = 1U << 22U;
enum BounceDimension : std::uint32_t { light_point, lobe, direction_to_go, roulette };
constexpr std::uint32_t kPerBounce = 8;
constexpr std::uint32_t dimensions_of(std::uint32_t first, int bounce) {
  return first + kPerBounce * static_cast<std::uint32_t>(bounce);
}

/// Paths that go on together: their vertices and connections stay in the processor's cache.
constexpr std::size_t kPathsAtOnce = 256;

/// Expected rays of a sample to connect vertices: those of little light are drawn by what they would
/// carry, and count more by as much.
constexpr double kConnections = 6.0;

/// The power heuristic's exponent, of a ratio of densities.
constexpr double mis(double ratio) { return ratio * ratio; }

/// Of a ray between two surfaces, without either.
Ray ray_between(const Vector3d& from, const Vector3d& to) {
  return {.origin = from, .direction = to - from, .t_max = 1.0};
}

Vector3d off_surface(const PathVertex& vertex, double more = 0.0) {
  return vertex.point + (vertex.offset_mm + more) * vertex.flat_normal;
}

}  // namespace

/// A sample of a pixel.
struct BidirectionalIntegrator::Path {
  PixelSamples numbers;
  int x;
  int y;
  double weight = 1.0;  ///< by the pixel's filter
  Vector2d lens = Vector2d::Zero();
  Vector3d radiance = Vector3d::Zero();
  Emission emission{};
  Vector2d path_tracing = Vector2d::Zero();  ///< told_of_path_tracing(), summed
  int last_vertex = -1;                      ///< of the light's path: of the batch's vertices
  double brightness = 0.0;                   ///< of all its connections, if they are not hidden
};

/// What of the sums of densities that a walk from a light keeps belongs to path tracing.
struct BidirectionalIntegrator::PathTracingDensities {
  double connects = 0.0;
  double earlier = 0.0;
};

/// One end of a path, on its way.
struct BidirectionalIntegrator::Walk {
  int path;
  Vector3d carried = Vector3d::Ones();  ///< what its bounces have left
  double radiance_scale = 1.0;          ///< of it: what refraction is yet to undo
  // Sums of densities over that of this path, each to the heuristic's exponent ([Georgiev12], eqs. (31)
  // to (36)): of the strategies that connect the last vertex but one to the last, and of those that
  // connect earlier ones. The latter is not yet times the density of the way back.
  double connects = 0.0;
  double earlier = 0.0;
  PathTracingDensities by_path_tracing{};  ///< of light's: of s = 0 and s = 1 alone
  LitPoint from{};                         ///< where its last direction was drawn
  double from_offset = 0.0;
};

struct BidirectionalIntegrator::Front {
  std::vector<Walk> walks;
  std::vector<PixelSamples> numbers;
  std::vector<Ray> rays;
  std::vector<RawHit> hits;
  std::vector<Vector2d> direction_squares;
  std::vector<Vector2d> light_squares;

  void clear() {
    walks.clear();
    numbers.clear();
    rays.clear();
  }
  void add(const Walk& walk, const PixelSamples& of_pixel, const Ray& ray) {
    walks.push_back(walk);
    numbers.push_back(of_pixel);
    rays.push_back(ray);
  }
};

struct BidirectionalIntegrator::LightVertex {
  PathVertex vertex;
  int path;
  int depth;       ///< bounces of light up to and with this one
  int before;      ///< the vertex before it on its path, of the batch's; -1: none
  Vector3d power;  ///< that arrives, over the densities
  double connects;
  double earlier;
  PathTracingDensities by_path_tracing;
};

/// Light that arrives if nothing is between.
struct BidirectionalIntegrator::Connection {
  int path;
  bool is_splat;
  Ray ray;
  Vector3d value;
  double brightness;
  Vector2d path_tracing;  ///< told_of_path_tracing()
  Vector2d at;            ///< of a splat: of the camera's picture
};

struct BidirectionalIntegrator::Batch {
  VertexLanes lanes{};
  std::array<Hit, kLanes> surfaces{};
  std::uint64_t n_rays = 0;
  std::vector<Path> paths;
  std::vector<PixelSamples> numbers;  ///< of all of them
  std::vector<Vector2d> pixel_squares;
  std::vector<Vector2d> point_squares;
  std::vector<Vector2d> direction_squares;
  std::vector<LightVertex> vertices;
  std::vector<Connection> connections;
  std::vector<Ray> rays;  ///< of those that are cast
  std::vector<std::size_t> cast;
  std::vector<double> survival;
  std::vector<std::uint8_t> blocked;
  Front front;
};

/// Where a walk meets a surface.
struct BidirectionalIntegrator::Met {
  std::size_t i;  ///< of the front
  std::size_t lane;
  const Ray& ray;
  const Hit& hit;
  double cosine;  ///< of the triangle's normal with the way back
};

BidirectionalIntegrator::BidirectionalIntegrator(const Scene& scene, const RayCaster& caster,
                                                 const Environment* environment, Camera camera,
                                                 const BidirectionalOptions& options)
    : scene_(&scene),
      caster_(&caster),
      camera_(std::move(camera)),
      options_(options),
      filter_(options.filter),
      lights_(scene, environment, caster.scene_radius_mm(), options.lights),
      emitters_(lights_, caster.scene_middle()),
      n_light_paths_(static_cast<double>(options.width) * options.height) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0 && options.sure_bounces >= 0,
                    "bounces are counted from 0");
  HAARLIGHT_EXPECTS(options.width > 0 && options.height > 0,
                    "splats go to a film of known size");
  HAARLIGHT_EXPECTS(options.lights != LightChoice::all, "one light is asked");
  for (std::size_t light = 0; light < lights_.size(); ++light) {
    const std::optional<std::uint32_t> surface = lights_.surface_of(light);
    light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
  }
}

bool BidirectionalIntegrator::counts(int light_vertices, int camera_vertices) const {
  return !options_.only || *options_.only == PathStrategy{light_vertices, camera_vertices};
}

/// @param others  sum over the other strategies of their density over this one's, to the heuristic's
///                exponent; infinite or no number where this one has none
double BidirectionalIntegrator::weight(double others) const {
  if (options_.only) {
    return 1.0;
  }
  return others < std::numeric_limits<double>::infinity() ? 1.0 / (1.0 + others) : 0.0;
}

/// What light that was found, f/p of it weighted, says of path tracing: the squares of its samples, and
/// light that they never meet (s = 0 and 1 have no density: lamps without extent by way of a mirror or
/// glass). The squares have the mean, over all light f dx, of
///
///     f sum_j w_j^2 / p_j,   w_j = p_j^2 / (p_0^2 + p_1^2),   j = 0, 1,
///
/// at least f / sqrt(2 (p_0^2 + p_1^2)), beside products of one sample's vertices, which are positive, too.
/// So this is a lower bound in the mean, and close to it where light is rare and found in one way.
/// @param value            a sample of the pixel's, weighted
/// @param by_path_tracing  (p_0^2 + p_1^2) over the density of this, squared
Vector2d BidirectionalIntegrator::told_of_path_tracing(const Vector3d& value, double weight,
                                                       double by_path_tracing) const {
  if (!options_.tells_of_path_tracing || !(weight > 0.0)) {
    return Vector2d::Zero();
  }
  if (!(by_path_tracing > 0.0)) {
    return {0.0, value.sum()};
  }
  const double squares = value.squaredNorm() / (weight * std::sqrt(2.0 * by_path_tracing));
  // Beyond what a double holds: far more than any picture's, and its sums are finite.
  return {std::isfinite(squares) ? squares : std::numeric_limits<float>::max(), 0.0};
}

/// The density with which s = 1 finds a point of a light from there: per mm^2 across the way, times the
/// squared distance; of one that is infinitely far per sr.
double BidirectionalIntegrator::asked_from(std::size_t light, const LitPoint& from,
                                           double offset_mm, const LightHit& hit) const {
  if (!(hit.distance_mm > nearest_asked(offset_mm, light_offsets_[light]))) {
    return 0.0;
  }
  const double squared = std::isfinite(hit.distance_mm) && !lights_.is_met(light) &&
                                 std::holds_alternative<PointSource>(lights_[light])
                             ? hit.distance_mm * hit.distance_mm
                             : 1.0;
  return lights_.probability(light, from) * asked_density(lights_[light], from.point, hit) *
         hit.cosine * squared;
}

// ---- The lights' paths -------------------------------------------------------------------------

void BidirectionalIntegrator::start_paths(const Tile& rows, Batch& batch) const {
  batch.paths.clear();
  batch.numbers.clear();
  for (int y = rows.y0; y < rows.y1; ++y) {
    for (int x = rows.x0; x < rows.x1; ++x) {
      batch.numbers.emplace_back(options_.sampler, options_.seed, x + options_.first_x,
                                 y + options_.first_y);
      batch.paths.push_back({.numbers = batch.numbers.back(), .x = x, .y = y});
    }
  }
  const std::size_t n = batch.paths.size();
  batch.pixel_squares.resize(n);
  batch.point_squares.resize(n);
  batch.direction_squares.resize(n);
}

void BidirectionalIntegrator::start_from_lights(std::uint32_t sample, Batch& batch) const {
  batch.front.clear();
  batch.vertices.clear();
  for (Path& path : batch.paths) {
    path.last_vertex = -1;
    path.radiance = Vector3d::Zero();
    path.path_tracing = Vector2d::Zero();
    path.brightness = 0.0;
    if (camera_.has_lens()) {
      path.lens = path.numbers.two(sample, kLensDimension);
    }
  }
  if (lights_.size() == 0 || options_.most_bounces == 0) {
    return;
  }
  PixelSamples::two(batch.numbers, sample, kEmissionPoint, batch.point_squares);
  PixelSamples::two(batch.numbers, sample, kEmissionDirection, batch.direction_squares);
  for (std::size_t i = 0; i < batch.paths.size(); ++i) {
    Path& path = batch.paths[i];
    path.emission = emitters_.emit(batch.point_squares[i], batch.direction_squares[i]);
    const Emission& emission = path.emission;
    if (emission.is_found && emission.power.maxCoeff() > 0.0) {
      const Vector3d origin = emission.point + light_offsets_[emission.light] * emission.normal;
      batch.front.add({.path = static_cast<int>(i)}, path.numbers,
                      {.origin = origin, .direction = emission.direction});
    }
  }
}

/// Casts the rays of the front, and calls visit(Met, walk, onward) for those that meet a surface, else
/// miss(ray, walk). What visit returns tells whether the walk goes on.
template <class Visit, class Miss>
void advance_front(const RayCaster& caster, std::uint32_t sample, std::uint32_t dimension,
                   RayOrder order, auto& batch, const Visit& visit, const Miss& miss) {
  auto& front = batch.front;
  const std::size_t n_all = front.rays.size();
  front.hits.resize(n_all);
  caster.intersect(front.rays, order, front.hits);
  batch.n_rays += n_all;
  front.direction_squares.resize(n_all);
  PixelSamples::two(front.numbers, sample, dimension + direction_to_go,
                    front.direction_squares);
  std::size_t n_on = 0;
  for (std::size_t begin = 0; begin < n_all; begin += kLanes) {
    const std::size_t n = std::min(kLanes, n_all - begin);
    caster.surfaces_at(std::span(front.rays).subspan(begin, n),
                       std::span(front.hits).subspan(begin, n),
                       std::span(batch.surfaces).first(n));
    for (std::size_t lane = 0; lane < n; ++lane) {
      if (front.hits[begin + lane].is_hit()) {
        const Vector3d& direction = front.rays[begin + lane].direction;
        batch.lanes.put(lane, shading_normal(batch.surfaces[lane], direction), direction,
                        front.direction_squares[begin + lane]);
      }
    }
    batch.lanes.find(n);
    for (std::size_t lane = 0; lane < n; ++lane) {
      const std::size_t i = begin + lane;
      auto walk = front.walks[i];
      Ray onward;
      const bool goes_on = front.hits[i].is_hit() ? visit(i, lane, walk, onward)
                                                  : (miss(front.rays[i], walk), false);
      if (goes_on) {
        front.walks[n_on] = walk;
        front.rays[n_on] = onward;
        front.numbers[n_on] = front.numbers[i];
        ++n_on;
      }
    }
  }
  front.walks.erase(front.walks.begin() + static_cast<std::ptrdiff_t>(n_on), front.walks.end());
  front.rays.resize(n_on);
  front.numbers.erase(front.numbers.begin() + static_cast<std::ptrdiff_t>(n_on),
                      front.numbers.end());
}

/// At the first surface that light meets: how else a path could have come from the light to here.
/// @return whether it could at all
bool BidirectionalIntegrator::leave_light(const Met& met, Walk& walk,
                                          const Batch& batch) const {
  const Emission& emission = batch.paths[static_cast<std::size_t>(walk.path)].emission;
  const LightHit back{.direction = -met.ray.direction,
                      .distance_mm = emission.is_far ? std::numeric_limits<double>::infinity()
                                                     : (emission.point - met.hit.point).norm(),
                      .cosine = emission.cosine};
  const double emitted = emitters_.density(emission.light, back) * met.cosine;
  if (!(emitted > 0.0)) {
    return false;
  }
  walk.connects =
      mis(asked_from(emission.light, {.point = met.hit.point, .normal = met.hit.flat_normal},
                     met.hit.offset_mm, back) /
          emitted);
  walk.earlier = lights_.is_met(emission.light) ? mis(emission.cosine / emitted) : 0.0;
  walk.by_path_tracing = {.connects = walk.connects, .earlier = walk.earlier};
  return true;
}

namespace {

PathVertex vertex_at(const Ray& ray, const Hit& hit, const VertexLanes& lanes, std::size_t lane,
                     const Bsdf& bsdf) {
  PathVertex vertex{.point = hit.point,
                    .flat_normal = hit.flat_normal,
                    .normal = hit.normal,
                    .back = -ray.direction,
                    .frame = Eigen::Matrix3d::Zero(),
                    .offset_mm = hit.offset_mm,
                    .is_smooth = hit.normal != hit.flat_normal,
                    .bsdf = bsdf};
  vertex.frame.col(0) = lanes.first[lane];
  vertex.frame.col(1) = lanes.second[lane];
  vertex.frame.col(2) = lanes.normal[lane];
  return vertex;
}

}  // namespace

/// Follows the lights' paths to their ends, and keeps their vertices.
void BidirectionalIntegrator::follow_lights(std::uint32_t sample, Batch& batch) const {
  for (int depth = 1; !batch.front.rays.empty(); ++depth) {
    const std::uint32_t dimension = dimensions_of(kFirstLightBounce, depth);
    const auto visit = [&](std::size_t i, std::size_t lane, Walk& walk, Ray& onward) {
      const Hit& hit = batch.surfaces[lane];
      const Ray& ray = batch.front.rays[i];
      const Met met{i, lane, ray, hit, -hit.flat_normal.dot(ray.direction)};
      if (!(met.cosine > 0.0)) {
        return false;
      }
      if (depth == 1) {
        if (!leave_light(met, walk, batch)) {
          return false;
        }
      } else {
        walk.connects *= mis(hit.distance_mm * hit.distance_mm / met.cosine);
        walk.earlier /= mis(met.cosine);
        walk.by_path_tracing.earlier /= mis(met.cosine);
      }
      const Bsdf bsdf = bsdf_of(*scene_, hit);
      if (is_black(bsdf)) {
        return false;
      }
      const PathVertex* kept = nullptr;
      if (has_smooth_part(bsdf)) {
        Path& path = batch.paths[static_cast<std::size_t>(walk.path)];
        batch.vertices.push_back({.vertex = vertex_at(ray, hit, batch.lanes, lane, bsdf),
                                  .path = walk.path,
                                  .depth = depth,
                                  .before = path.last_vertex,
                                  .power = path.emission.power.cwiseProduct(walk.carried),
                                  .connects = walk.connects,
                                  .earlier = walk.earlier,
                                  .by_path_tracing = walk.by_path_tracing});
        path.last_vertex = static_cast<int>(batch.vertices.size()) - 1;
        see_from_camera(batch.vertices.back(), depth, batch);
        kept = &batch.vertices.back().vertex;
      }
      return depth < options_.most_bounces &&
             scatter(sample, dimension, true, depth - 1, met, kept, batch, walk, onward);
    };
    advance_front(*caster_, sample, dimension, RayOrder::scattered, batch, visit,
                  [](const Ray&, const Walk&) {});
  }
}

/// t = 1: the picture of a vertex of the light's path.
void BidirectionalIntegrator::see_from_camera(const LightVertex& from, int depth,
                                              Batch& batch) const {
  if (!counts(depth + 1, 1)) {
    return;
  }
  Path& path = batch.paths[static_cast<std::size_t>(from.path)];
  const PathVertex& vertex = from.vertex;
  const std::optional<CameraSight> sight = camera_.sees(vertex.point, path.lens);
  if (!sight) {
    return;
  }
  const double reach = filter_.radius();
  const double x = sight->at.x() - options_.first_x;
  const double y = sight->at.y() - options_.first_y;
  if (!(x > -reach && y > -reach && x < options_.width + reach &&
        y < options_.height + reach)) {
    return;
  }
  const Scattering here = scattering_at(vertex, -sight->ray.direction, vertex.back);
  if (!(here.f.maxCoeff() > 0.0)) {
    return;
  }
  const double arrives =
      here.eye_cosine * sight->pixels_per_sr / (sight->distance_mm * sight->distance_mm);
  const double seen = mis(arrives / n_light_paths_);
  const double w = weight(seen * (from.connects + from.earlier * mis(here.light_from_eye)));
  const Vector3d value = (w * arrives) * from.power.cwiseProduct(here.f);
  const Vector3d target = off_surface(vertex, kRounding * kOfWay * sight->distance_mm);
  Ray ray = ray_between(sight->ray.origin, target);
  ray.t_min = sight->ray.t_min / sight->distance_mm;
  const double brightness = value.mean() / n_light_paths_;
  const double by_path_tracing =
      seen *
      (from.by_path_tracing.connects + from.by_path_tracing.earlier * mis(here.light_from_eye));
  path.brightness += brightness;
  batch.connections.push_back(
      {.path = from.path,
       .is_splat = true,
       .ray = ray,
       .value = value,
       .brightness = brightness,
       .path_tracing = told_of_path_tracing(value / n_light_paths_, w, by_path_tracing),
       .at = {x, y}});
}

// ---- The camera's paths ------------------------------------------------------------------------

void BidirectionalIntegrator::start_from_camera(std::uint32_t sample, Batch& batch) const {
  batch.front.clear();
  PixelSamples::two(batch.numbers, sample, kPixelDimension, batch.pixel_squares);
  for (std::size_t i = 0; i < batch.paths.size(); ++i) {
    Path& path = batch.paths[i];
    const PixelFilter::Sample at = filter_.sample(batch.pixel_squares[i]);
    path.weight = at.weight;
    const double x = path.x + options_.first_x + 0.5 + at.offset.x();
    const double y = path.y + options_.first_y + 0.5 + at.offset.y();
    const Ray ray = camera_.ray(x, y, path.lens);
    const double pixels_per_sr = camera_.pixels_per_sr(ray, x, y);
    batch.front.add(
        {.path = static_cast<int>(i),
         // All light paths of a sample of the picture may have found the first vertex.
         .connects = pixels_per_sr > 0.0 ? mis(n_light_paths_ / pixels_per_sr) : 0.0},
        path.numbers, ray);
  }
}

void BidirectionalIntegrator::follow_camera(std::uint32_t sample, FilmTile& tile,
                                            Batch& batch) const {
  const bool asks = lights_.size() > 0;
  for (int bounce = 0; !batch.front.rays.empty(); ++bounce) {
    const std::uint32_t dimension = dimensions_of(kFirstBounce, bounce);
    Front& front = batch.front;
    if (asks && bounce < options_.most_bounces) {
      front.light_squares.resize(front.rays.size());
      PixelSamples::two(front.numbers, sample, dimension + light_point, front.light_squares);
    }
    const auto visit = [&](std::size_t i, std::size_t lane, Walk& walk, Ray& onward) {
      const Hit& hit = batch.surfaces[lane];
      const Ray& ray = front.rays[i];
      const Met met{i, lane, ray, hit, -hit.flat_normal.dot(ray.direction)};
      if (bounce == 0 && options_.has_features) {
        const Path& path = batch.paths[static_cast<std::size_t>(walk.path)];
        add_features(*scene_, ray, hit, camera_.axis(), path.weight, path.x, path.y, tile);
      }
      if (!(met.cosine > 0.0)) {
        return false;
      }
      walk.connects *= mis(hit.distance_mm * hit.distance_mm / met.cosine);
      walk.earlier /= mis(met.cosine);
      add_emission(met, bounce, walk, batch);
      if (bounce == options_.most_bounces) {
        return false;
      }
      const Bsdf bsdf = bsdf_of(*scene_, hit);
      if (is_black(bsdf)) {
        return false;
      }
      if (!has_smooth_part(bsdf)) {
        return scatter(sample, dimension, false, bounce, met, nullptr, batch, walk, onward);
      }
      const PathVertex vertex = vertex_at(ray, hit, batch.lanes, lane, bsdf);
      if (asks) {
        ask_light(vertex, bounce, walk, front.light_squares[i], batch);
        connect(vertex, bounce, walk, batch);
      }
      return scatter(sample, dimension, false, bounce, met, &vertex, batch, walk, onward);
    };
    advance_front(
        *caster_, sample, dimension, bounce == 0 ? RayOrder::coherent : RayOrder::scattered,
        batch, visit,
        [&](const Ray& ray, const Walk& walk) { add_environment(ray, bounce, walk, batch); });
  }
}

/// s = 0. @param asked, traced  densities of s = 1 and of the others over this one's, squared
void BidirectionalIntegrator::add_met_light(const Vector3d& light, double asked, double traced,
                                            Path& path) const {
  const double w = weight(asked + traced);
  const Vector3d value = w * light;
  path.radiance += value;
  path.path_tracing += told_of_path_tracing(value, w, 1.0 + asked);
}

/// s = 0, a surface.
void BidirectionalIntegrator::add_emission(const Met& met, int bounce, const Walk& walk,
                                           Batch& batch) const {
  const auto surface = static_cast<std::uint32_t>(met.hit.mesh);
  const std::optional<std::size_t> light = lights_.of_surface(surface);
  if (!light || !met.hit.is_front || !counts(0, bounce + 2)) {
    return;
  }
  double asked = 0.0;
  double traced = 0.0;
  if (bounce > 0) {
    const LightHit hit{.direction = met.ray.direction,
                       .distance_mm = met.hit.distance_mm,
                       .cosine = met.cosine};
    if (walk.connects > 0.0) {
      asked = mis(asked_from(*light, walk.from, walk.from_offset, hit) /
                  (hit.distance_mm * hit.distance_mm)) *
              walk.connects;
    }
    traced = mis(emitters_.density(*light, hit)) * walk.earlier;
  }
  add_met_light(walk.carried.cwiseProduct(lights_.radiance_of_surface(surface)), asked, traced,
                batch.paths[static_cast<std::size_t>(walk.path)]);
}

/// s = 0, from infinitely far.
void BidirectionalIntegrator::add_environment(const Ray& ray, int bounce, const Walk& walk,
                                              Batch& batch) const {
  const std::optional<std::size_t> light = lights_.environment();
  if (!light || !counts(0, bounce + 2)) {
    return;
  }
  double asked = 0.0;
  double traced = 0.0;
  if (bounce > 0) {
    const LightHit hit{.direction = ray.direction,
                       .distance_mm = std::numeric_limits<double>::infinity(),
                       .cosine = 1.0};
    if (walk.connects > 0.0) {
      asked = mis(asked_from(*light, walk.from, walk.from_offset, hit)) * walk.connects;
    }
    traced = mis(emitters_.density(*light, hit)) * walk.earlier;
  }
  const auto& environment = std::get<EnvironmentSourceLight>(lights_[*light]);
  add_met_light(walk.carried.cwiseProduct(environment.light.radiance(ray.direction)), asked,
                traced, batch.paths[static_cast<std::size_t>(walk.path)]);
}

/// s = 1: a point of a light is drawn as seen from the vertex.
void BidirectionalIntegrator::ask_light(const PathVertex& vertex, int bounce, const Walk& walk,
                                        const Vector2d& square, Batch& batch) const {
  if (!counts(1, bounce + 2)) {
    return;
  }
  const LitPoint at{.point = vertex.point, .normal = vertex.flat_normal};
  const std::optional<ChosenLight> chosen = lights_.choose(at, square);
  if (!chosen) {
    return;
  }
  const Light& light = lights_[chosen->index];
  const LightSample drawn = render::sample(light, vertex.point, chosen->square);
  if (!drawn.is_found ||
      !(drawn.distance_mm > nearest_asked(vertex.offset_mm, light_offsets_[chosen->index]))) {
    return;
  }
  const Scattering here = scattering_at(vertex, vertex.back, drawn.direction);
  const double cosine = cosine_at(light, drawn);
  if (!(here.f.maxCoeff() > 0.0) || !(cosine > 0.0)) {
    return;
  }
  const double density = chosen->probability * drawn.density;
  const bool is_point = drawn.is_delta && std::isfinite(drawn.distance_mm);
  const double asked =
      density * cosine * (is_point ? drawn.distance_mm * drawn.distance_mm : 1.0);
  const double emitted = emitters_.density(
      chosen->index,
      {.direction = drawn.direction, .distance_mm = drawn.distance_mm, .cosine = cosine});
  const double met = lights_.is_met(chosen->index) ? mis(here.light_from_eye / density) : 0.0;
  const double traced = mis(emitted * here.light_cosine / asked) *
                        (walk.connects + walk.earlier * mis(here.eye_from_light));
  const double w = weight(met + traced);
  const Vector3d value = (w * here.light_cosine / density) *
                         walk.carried.cwiseProduct(here.f).cwiseProduct(drawn.radiance);
  const Vector3d origin = off_surface(vertex);
  Ray ray{.origin = origin, .direction = drawn.direction};
  if (std::isfinite(drawn.distance_mm)) {
    const double off = light_offsets_[chosen->index] + kRounding * kOfWay * drawn.distance_mm;
    ray = ray_between(origin,
                      vertex.point + drawn.distance_mm * drawn.direction + off * drawn.normal);
  }
  const double brightness = value.mean();
  batch.paths[static_cast<std::size_t>(walk.path)].brightness += brightness;
  batch.connections.push_back({.path = walk.path,
                               .is_splat = false,
                               .ray = ray,
                               .value = value,
                               .brightness = brightness,
                               .path_tracing = told_of_path_tracing(value, w, 1.0 + met),
                               .at = Vector2d::Zero()});
}

/// s >= 2, t >= 2: to all vertices of the light's path.
void BidirectionalIntegrator::connect(const PathVertex& vertex, int bounce, const Walk& walk,
                                      Batch& batch) const {
  Path& path = batch.paths[static_cast<std::size_t>(walk.path)];
  for (int i = path.last_vertex; i >= 0;) {
    const LightVertex& other = batch.vertices[static_cast<std::size_t>(i)];
    i = other.before;
    if (bounce + 1 + other.depth > options_.most_bounces ||
        !counts(other.depth + 1, bounce + 2)) {
      continue;
    }
    const Vector3d way = other.vertex.point - vertex.point;
    const double squared = way.squaredNorm();
    const double height = vertex.flat_normal.dot(way);
    const double other_height = -other.vertex.flat_normal.dot(way);
    if (!(height > 0.0 && other_height > 0.0)) {
      continue;
    }
    const double distance = std::sqrt(squared);
    if (!(distance > nearest_asked(vertex.offset_mm, other.vertex.offset_mm))) {
      continue;
    }
    const Vector3d direction = way / distance;
    const Scattering here = scattering_at(vertex, vertex.back, direction);
    const Scattering there = scattering_at(other.vertex, -direction, other.vertex.back);
    const Vector3d f = here.f.cwiseProduct(there.f);
    if (!(f.maxCoeff() > 0.0)) {
      continue;
    }
    const double there_from_here = here.light_from_eye * there.eye_cosine / squared;
    const double here_from_there = there.eye_from_light * here.light_cosine / squared;
    const double others =
        mis(there_from_here) * (other.connects + other.earlier * mis(there.light_from_eye)) +
        mis(here_from_there) * (walk.connects + walk.earlier * mis(here.eye_from_light));
    const double w = weight(others);
    const Vector3d value = (w * here.light_cosine * there.eye_cosine / squared) *
                           walk.carried.cwiseProduct(other.power).cwiseProduct(f);
    const double brightness = value.mean();
    const double by_path_tracing =
        mis(there_from_here) * (other.by_path_tracing.connects +
                                other.by_path_tracing.earlier * mis(there.light_from_eye));
    path.brightness += brightness;
    batch.connections.push_back(
        {.path = walk.path,
         .is_splat = false,
         .ray = ray_between(off_surface(vertex),
                            off_surface(other.vertex, kRounding * kOfWay * distance)),
         .value = value,
         .brightness = brightness,
         .path_tracing = told_of_path_tracing(value, w, by_path_tracing),
         .at = Vector2d::Zero()});
  }
}

// ---- Both --------------------------------------------------------------------------------------

/// Draws the direction in which a path goes on.
/// @param vertex  there; nothing: the surface has delta lobes only
/// @return whether it does: `onward`
bool BidirectionalIntegrator::scatter(std::uint32_t sample, std::uint32_t dimension,
                                      bool is_from_light, int bounce, const Met& met,
                                      const PathVertex* vertex, Batch& batch, Walk& walk,
                                      Ray& onward) const {
  const Hit& hit = met.hit;
  const PixelSamples& numbers = batch.front.numbers[met.i];
  const Vector2d& square = batch.front.direction_squares[met.i];
  const Vector3d to_back = batch.lanes.to_eye[met.lane];
  Vector3d direction = Vector3d::UnitZ();
  double shading_in = to_back.z();
  double shading_out = 0.0;
  const BsdfSample next = std::visit(
      [&]<class Kind>(const Kind& bsdf) {
        if constexpr (std::is_same_v<Kind, Lambert>) {
          direction = batch.lanes.cosine_world[met.lane];
          return bsdf.sample(to_back, batch.lanes.cosine_local[met.lane]);
        } else {
          const double which = kHasLobes<Kind> ? numbers.one(sample, dimension + lobe) : 0.0;
          BsdfSample drawn = bsdf.sample(to_back, which, square);
          direction = batch.lanes.first[met.lane] * drawn.to_light.x() +
                      batch.lanes.second[met.lane] * drawn.to_light.y() +
                      batch.lanes.normal[met.lane] * drawn.to_light.z();
          if constexpr (kIsSpecular<Kind>) {
            const bool is_mended = !is_on_its_side(hit, drawn, direction);
            mend_specular(bsdf, met.ray, hit, to_back, which, square, drawn, direction);
            shading_in = is_mended ? met.cosine : shading_in;
          }
          return drawn;
        }
      },
      vertex != nullptr ? vertex->bsdf : bsdf_of(*scene_, hit));
  if (!next.is_found || !is_on_its_side(hit, next, direction)) {
    return false;
  }
  shading_out = std::abs(next.to_light.z());
  const double cosine_out = std::abs(hit.flat_normal.dot(direction));
  Vector3d carries = next.weight;
  if (next.is_delta) {
    // Densities are deltas; what is left of their ratio is that of the cones' solid angles.
    const double onward_density =
        mis(cosine_out * next.radiance_scale * shading_in / shading_out);
    walk.connects = 0.0;
    walk.earlier *= onward_density;
    walk.by_path_tracing.earlier *= onward_density;
    if (is_from_light) {
      // Flux is not scaled as radiance is [Veach97], section 5.2; shading normals: section 5.3.
      carries *= shading_in * cosine_out / (next.radiance_scale * met.cosine * shading_out);
    } else {
      walk.radiance_scale *= next.radiance_scale;
    }
  } else {
    const Scattering here = is_from_light ? scattering_at(*vertex, direction, vertex->back)
                                          : scattering_at(*vertex, vertex->back, direction);
    const double forward = is_from_light ? here.eye_from_light : here.light_from_eye;
    const double backward = is_from_light ? here.light_from_eye : here.eye_from_light;
    if (is_from_light && vertex->is_smooth) {
      carries = here.f * (here.eye_cosine / forward);
    }
    walk.earlier = mis(cosine_out / forward) * (walk.earlier * mis(backward) + walk.connects);
    walk.connects = mis(1.0 / forward);
    walk.by_path_tracing.earlier =
        mis(cosine_out / forward) *
        (walk.by_path_tracing.earlier * mis(backward) + walk.by_path_tracing.connects);
  }
  walk.by_path_tracing.connects = 0.0;
  walk.carried = walk.carried.cwiseProduct(carries);
  if (!(walk.carried.maxCoeff() > 0.0)) {
    return false;
  }
  if (bounce >= options_.sure_bounces) {
    const double survives = std::min(1.0, walk.carried.maxCoeff() / walk.radiance_scale);
    if (!(numbers.one(sample, dimension + roulette) < survives)) {
      return false;
    }
    walk.carried /= survives;
  }
  walk.from = {.point = hit.point, .normal = hit.flat_normal};
  walk.from_offset = hit.offset_mm;
  const double side = next.is_transmission ? -hit.offset_mm : hit.offset_mm;
  onward = {.origin = hit.point + side * hit.flat_normal, .direction = direction};
  return true;
}

/// Casts the rays of connections, and adds the light of those that nothing hides. Of a sample's many
/// dim ones some are drawn.
void BidirectionalIntegrator::settle(std::uint32_t sample, Batch& batch, FilmTile& tile) const {
  batch.rays.clear();
  batch.cast.clear();
  batch.survival.clear();
  for (std::size_t i = 0; i < batch.connections.size(); ++i) {
    const Connection& connection = batch.connections[i];
    const Path& path = batch.paths[static_cast<std::size_t>(connection.path)];
    const double survives = kConnections * connection.brightness / path.brightness;
    if (survives < 1.0) {
      const std::uint64_t key =
          hash_key(options_.seed + (std::uint64_t{sample} << 32U),
                   static_cast<std::uint32_t>(path.x + options_.first_x),
                   static_cast<std::uint32_t>(path.y + options_.first_y), i + 1);
      if (!(uniform_unit(key) < survives)) {
        continue;
      }
    }
    batch.rays.push_back(connection.ray);
    batch.cast.push_back(i);
    batch.survival.push_back(std::min(1.0, survives));
  }
  batch.blocked.resize(batch.rays.size());
  caster_->are_blocked(batch.rays, RayOrder::scattered, batch.blocked);
  batch.n_rays += batch.rays.size();
  for (std::size_t k = 0; k < batch.cast.size(); ++k) {
    if (batch.blocked[k] != 0) {
      continue;
    }
    const Connection& connection = batch.connections[batch.cast[k]];
    const Vector3d value = connection.value / batch.survival[k];
    Path& path = batch.paths[static_cast<std::size_t>(connection.path)];
    double seen = 1.0;
    if (connection.is_splat) {
      seen = add_splat(connection, value, tile);
    } else {
      path.radiance += value;
    }
    path.path_tracing += (seen / batch.survival[k]) * connection.path_tracing;
  }
  batch.connections.clear();
}

/// To all pixels whose filters see it. @return the sum of these filters there
double BidirectionalIntegrator::add_splat(const Connection& connection, const Vector3d& value,
                                          FilmTile& tile) const {
  const double reach = filter_.radius() + 0.5;
  const auto first = [&](double at) {
    return std::max(0, static_cast<int>(std::ceil(at - reach)));
  };
  const auto end = [&](double at, int size) {
    return std::min(size, static_cast<int>(std::floor(at + reach - 1.0)) + 1);
  };
  const int x_end = end(connection.at.x(), options_.width);
  const int y_end = end(connection.at.y(), options_.height);
  double sum = 0.0;
  for (int y = first(connection.at.y()); y < y_end; ++y) {
    for (int x = first(connection.at.x()); x < x_end; ++x) {
      const double filter = filter_.value(connection.at - Vector2d(x + 0.5, y + 0.5));
      if (filter != 0.0) {
        tile.add_splat(x, y, filter * value);
        sum += filter;
      }
    }
  }
  return sum;
}

std::uint64_t BidirectionalIntegrator::render_tile(SampleRange samples, FilmTile& tile) const {
  Batch batch;
  const Tile& area = tile.area();
  const int rows = std::max(1, static_cast<int>(kPathsAtOnce) / area.width());
  for (int y = area.y0; y < area.y1; y += rows) {
    start_paths({.x0 = area.x0, .y0 = y, .x1 = area.x1, .y1 = std::min(y + rows, area.y1)},
                batch);
    for (std::uint32_t sample = samples.first; sample < samples.end; ++sample) {
      start_from_lights(sample, batch);
      follow_lights(sample, batch);
      start_from_camera(sample, batch);
      follow_camera(sample, tile, batch);
      settle(sample, batch, tile);
      for (const Path& path : batch.paths) {
        tile.add(path.x, path.y, SurfaceLayer::kRadiance, (path.weight * path.radiance).eval());
        if (options_.tells_of_path_tracing) {
          tile.add(path.x, path.y, SurfaceLayer::path_tracing(options_.has_features),
                   std::span<const double>(path.path_tracing.data(), 2));
        }
      }
    }
  }
  return batch.n_rays;
}

}  // namespace haarlight::render
