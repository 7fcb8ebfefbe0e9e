// SPDX-License-Identifier: Apache-2.0
#include "render/surface/ray_integrator.h"

#include <optional>
#include <type_traits>
#include <utility>
#include <variant>

#include "render/bsdf/shading_frame.h"
#include "render/surface/light_ray.h"
#include "render/surface/specular_direction.h"
#include "render/surface/surface_layers.h"

namespace haarlight::render {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

// Dimensions of a sample: the pixel's, the lens', then those of each bounce.
constexpr std::uint32_t kPixelDimension = 0;
constexpr std::uint32_t kLensDimension = 1;
constexpr std::uint32_t kFirstBounce = 2;
constexpr std::uint32_t kAllLights = 1U << 24U;

}  // namespace

std::uint32_t SampleNumbers::dimension(int bounce, std::uint32_t question) {
  return kFirstBounce + kQuestions * static_cast<std::uint32_t>(bounce) + question;
}

Vector2d SampleNumbers::light_point(int bounce, std::size_t light, std::size_t n_lights) const {
  return pixel_->two(sample_,
                     kAllLights + static_cast<std::uint32_t>(
                                      static_cast<std::size_t>(bounce) * n_lights + light));
}

RayIntegrator::RayIntegrator(const Scene& scene, const RayCaster& caster,
                             const Environment* environment, Camera camera,
                             const RayOptions& options)
    : scene_(&scene),
      caster_(&caster),
      camera_(std::move(camera)),
      options_(options),
      filter_(options.filter),
      lights_(scene, environment, caster.scene_radius_mm(), options.lights) {
  for (std::size_t light = 0; light < lights_.size(); ++light) {
    const std::optional<std::uint32_t> surface = lights_.surface_of(light);
    light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
  }
}

RayIntegrator::SurfacePoint RayIntegrator::surface_at(const Ray& ray, const RawHit& raw) const {
  const Hit hit = caster_->surface_at(ray, raw);
  const Matrix3d world_from_local = shading_frame(hit, ray.direction);
  return {.hit = hit,
          .world_from_local = world_from_local,
          .to_eye = -(world_from_local.transpose() * ray.direction),
          .bsdf = bsdf_of(*scene_, hit)};
}

std::optional<BsdfSample> RayIntegrator::go_on(const SurfacePoint& at, double lobe,
                                               const Vector2d& square, Ray& ray) {
  BsdfSample next = sample(at.bsdf, at.to_eye, lobe, square);
  Vector3d direction = at.world_from_local * next.to_light;
  std::visit(
      [&](const auto& bsdf) {
        if constexpr (kIsSpecular<std::decay_t<decltype(bsdf)>>) {
          mend_specular(bsdf, ray, at.hit, at.to_eye, lobe, square, next, direction);
        }
      },
      at.bsdf);
  if (!next.is_found || !is_on_its_side(at.hit, next, direction)) {
    return std::nullopt;
  }
  const double side = next.is_transmission ? -at.hit.offset_mm : at.hit.offset_mm;
  ray = {.origin = at.hit.point + side * at.hit.flat_normal, .direction = direction};
  return next;
}

RayIntegrator::SpecularWay RayIntegrator::follow_specular(Ray ray, const SampleNumbers& numbers,
                                                          int most_bounces,
                                                          std::uint64_t& n_rays) const {
  SpecularWay way;
  for (;; ++way.bounces) {
    const RawHit raw = caster_->intersect(ray);
    ++n_rays;
    if (!raw.is_hit()) {
      way.sum += way.throughput.cwiseProduct(emitted_from_afar(ray));
      return way;
    }
    const SurfacePoint at = surface_at(ray, raw);
    way.sum += way.throughput.cwiseProduct(emitted(at.hit));
    if (has_smooth_part(at.bsdf)) {
      way.end = at;
      return way;
    }
    if (way.bounces == most_bounces) {
      return way;
    }
    const std::optional<BsdfSample> next =
        go_on(at, numbers.one(way.bounces, SampleNumbers::lobe),
              numbers.two(way.bounces, SampleNumbers::direction_to_go), ray);
    if (!next) {
      return way;
    }
    way.throughput = way.throughput.cwiseProduct(next->weight);
  }
}

Vector3d RayIntegrator::emitted(const Hit& hit) const {
  const auto surface = static_cast<std::uint32_t>(hit.mesh);
  return hit.is_front && lights_.of_surface(surface) ? lights_.radiance_of_surface(surface)
                                                     : Vector3d::Zero();
}

Vector3d RayIntegrator::emitted_from_afar(const Ray& ray) const {
  const std::optional<std::size_t> light = lights_.environment();
  return light ? std::get<EnvironmentSourceLight>(lights_[*light]).light.radiance(ray.direction)
               : Vector3d::Zero();
}

std::optional<RayIntegrator::AskedLight> RayIntegrator::ask_light(
    const SurfacePoint& at, std::size_t light, const Vector2d& square) const {
  const LightSample from = render::sample(lights_[light], at.hit.point, square);
  if (!from.is_found ||
      !(from.distance_mm > nearest_asked(at.hit.offset_mm, light_offsets_[light])) ||
      !(at.hit.flat_normal.dot(from.direction) > 0.0)) {
    return std::nullopt;
  }
  const Vector3d to_light = at.world_from_local.transpose() * from.direction;
  const Vector3d f = evaluate(at.bsdf, at.to_eye, to_light);
  if (!(f.maxCoeff() > 0.0)) {
    return std::nullopt;
  }
  return AskedLight{.light = from,
                    .to_light = to_light,
                    .f = f,
                    .ray = light_ray(at.hit, from, light_offsets_[light])};
}

Vector3d RayIntegrator::sum_of_seen(const std::vector<Ray>& rays,
                                    const std::vector<Vector3d>& arrives,
                                    std::uint64_t& n_rays) const {
  std::vector<std::uint8_t> blocked(rays.size());
  caster_->are_blocked(rays, RayOrder::scattered, blocked);
  n_rays += rays.size();
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (blocked[i] == 0) {
      sum += arrives[i];
    }
  }
  return sum;
}

Vector3d RayIntegrator::direct_light(const SurfacePoint& at, const SampleNumbers& numbers,
                                     int bounce, std::uint64_t& n_rays) const {
  std::vector<Ray> rays;
  std::vector<Vector3d> arrives;
  for (std::size_t i = 0; i < lights_.size(); ++i) {
    if (const std::optional<AskedLight> asked =
            ask_light(at, i, numbers.light_point(bounce, i, lights_.size()))) {
      const auto& [light, to_light, f, ray] = *asked;
      rays.push_back(ray);
      arrives.emplace_back(to_light.z() / light.density * f.cwiseProduct(light.radiance));
    }
  }
  return sum_of_seen(rays, arrives, n_rays);
}

std::uint64_t RayIntegrator::render_tile(SampleRange samples, FilmTile& tile) const {
  std::uint64_t n_rays = 0;
  const Tile& area = tile.area();
  for (int y = area.y0; y < area.y1; ++y) {
    for (int x = area.x0; x < area.x1; ++x) {
      const int camera_x = x + options_.first_x;
      const int camera_y = y + options_.first_y;
      const PixelSamples pixel(options_.sampler, options_.seed, camera_x, camera_y);
      for (std::uint32_t sample = samples.first; sample < samples.end; ++sample) {
        const PixelFilter::Sample at = filter_.sample(pixel.two(sample, kPixelDimension));
        const Vector2d lens =
            camera_.has_lens() ? pixel.two(sample, kLensDimension) : Vector2d::Zero();
        const Ray ray =
            camera_.ray(camera_x + 0.5 + at.offset.x(), camera_y + 0.5 + at.offset.y(), lens);
        const Vector3d seen = radiance(ray, SampleNumbers(pixel, sample), n_rays);
        tile.add(x, y, SurfaceLayer::kRadiance, (at.weight * seen).eval());
        if (options_.has_features) {
          const RawHit raw = caster_->intersect(ray);
          ++n_rays;
          if (raw.is_hit()) {
            add_features(*scene_, ray, caster_->surface_at(ray, raw), camera_.axis(), at.weight,
                         x, y, tile);
          }
        }
      }
    }
  }
  return n_rays;
}

}  // namespace haarlight::render
