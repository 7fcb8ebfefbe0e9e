// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/patch_rays.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <variant>

#include <Eigen/Geometry>

#include "core/parallel.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/shading_frame.h"
#include "render/radiosity/patch_light.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

enum Question : std::uint32_t { point, direction, light, eye };
/// Whose numbers: the second key of a point's samples, that of no pixel.
enum Numbers : int { of_sides = -1, of_vertices = -2, of_probes = -3 };

constexpr std::uint32_t kLightSamples = 256;  // of each side: direct light is smooth over most
constexpr std::size_t kSidesAtOnce = 64;

bool is_back(std::size_t side) { return side % 2 != 0; }

/// A ray from there by the cosine law.
Ray leaving(const Hit& hit, const Vector2d& square) {
  return {.origin = hit.point + hit.offset_mm * hit.flat_normal,
          .direction = frame_of(hit.flat_normal) * cosine_direction(square)};
}

}  // namespace

PatchRays::PatchRays(const Scene& scene, const RayCaster& caster,
                     const Environment* environment, const Patches& patches,
                     std::uint32_t n_rays, std::uint64_t seed)
    : scene_(&scene),
      caster_(&caster),
      patches_(&patches),
      n_rays_(n_rays),
      seed_(seed),
      lights_(scene, environment, caster.scene_radius_mm(), LightChoice::tree) {
  for (std::size_t i = 0; i < lights_.size(); ++i) {
    const std::optional<std::uint32_t> surface = lights_.surface_of(i);
    light_offsets_.push_back(surface ? caster.most_offset_mm(*surface) : 0.0);
  }
}

PixelSamples PatchRays::numbers(std::size_t of, int whose) const {
  return {SamplerKind::sobol, seed_, static_cast<int>(of), whose};
}

/// A point of a triangle's side, as if a ray had met it.
Hit PatchRays::on(const CutTriangle& triangle, bool is_front, const Vector2d& uv) const {
  const Vector3d normal = is_front ? triangle.normal : Vector3d(-triangle.normal);
  const double away = std::sqrt(triangle.area_mm2);
  return caster_->surface_at({.origin = triangle.at(uv) + away * normal, .direction = -normal},
                             {.t = static_cast<float>(away),
                              .u = static_cast<float>(uv.x()),
                              .v = static_cast<float>(uv.y()),
                              .mesh = triangle.surface,
                              .triangle = triangle.triangle});
}

/// The side that a ray has met.
std::size_t PatchRays::side_of(const Ray& ray, const PatchPoint& met) const {
  const bool is_front = patches_->triangle_of(met.patch).normal.dot(ray.direction) < 0.0;
  return 2 * met.patch + (is_front ? 0 : 1);
}

std::optional<std::size_t> PatchRays::side_of(const Ray& ray, const RawHit& raw) const {
  if (!raw.is_hit()) {
    return std::nullopt;
  }
  const std::optional<PatchPoint> met = patches_->find(raw);
  return met ? std::optional<std::size_t>(side_of(ray, *met)) : std::nullopt;
}

void PatchRays::cast(const std::vector<Ray>& rays, std::vector<RawHit>& hits) const {
  hits.resize(rays.size());
  caster_->intersect(rays, RayOrder::scattered, hits);
}

std::optional<Seen> PatchRays::seen(std::optional<std::size_t> side) const {
  return side ? std::optional<Seen>(2 * patches_->triangle_of(*side / 2).surface +
                                    static_cast<Seen>(*side % 2))
              : std::nullopt;
}

std::vector<SeenFromPoint> PatchRays::seen_from(std::size_t side, std::uint32_t n_points,
                                                std::uint32_t n_of_point) const {
  const std::size_t patch = side / 2;
  const PixelSamples numbers = this->numbers(side, of_probes);
  std::vector<Ray> rays;
  for (std::uint32_t i = 0; i < n_points; ++i) {
    const Hit hit = on(patches_->triangle_of(patch), !is_back(side),
                       patches_->uv_in(patch, numbers.two(i, point)));
    for (std::uint32_t k = 0; k < n_of_point; ++k) {
      rays.push_back(leaving(hit, numbers.two(i * n_of_point + k, direction)));
    }
  }
  std::vector<RawHit> hits;
  cast(rays, hits);
  std::vector<SeenFromPoint> points(n_points);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    SeenFromPoint& from_point = points[i / n_of_point];
    const std::optional<Seen> met = seen(side_of(rays[i], hits[i]));
    if (std::ranges::find(from_point, met) == from_point.end()) {
      from_point.push_back(met);
    }
  }
  return points;
}

// Two rays of a point tell of most sides that nothing stands on them, and of those with many small things
// around that they tell nothing.
std::optional<std::vector<Seen>> PatchRays::seen_within(std::size_t side) const {
  const std::size_t n = n_groups(seen_from(side, 32, 2));
  if (n < 2 || n > 8) {
    return std::nullopt;
  }
  return render::seen_within(seen_from(side, 64, 8));
}

Elements PatchRays::elements() const {
  std::vector<std::optional<std::vector<Seen>>> within(2 * patches_->size());
  parallel_for(within.size(), kSidesAtOnce, [&](std::size_t begin, std::size_t end) {
    for (std::size_t side = begin; side < end; ++side) {
      within[side] = seen_within(side);
    }
  });
  Elements elements(within.size());
  for (std::size_t side = 0; side < within.size(); ++side) {
    if (within[side]) {
      elements.split(side, std::move(*within[side]));
    }
  }
  return elements;
}

PatchRays::Met PatchRays::met_by(const Elements& elements, std::size_t side) const {
  const std::size_t patch = side / 2;
  const CutTriangle& triangle = patches_->triangle_of(patch);
  const PixelSamples numbers = this->numbers(side, of_sides);
  std::vector<Ray> rays(n_rays_);
  for (std::uint32_t i = 0; i < n_rays_; ++i) {
    const Hit hit = on(triangle, !is_back(side), patches_->uv_in(patch, numbers.two(i, point)));
    rays[i] = leaving(hit, numbers.two(i, direction));
  }
  std::vector<RawHit> hits;
  cast(rays, hits);
  Met met;
  const std::optional<Seen> own = seen(side);
  std::array<std::vector<std::uint32_t>, 2> others;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const std::optional<std::size_t> other = side_of(rays[i], hits[i]);
    const std::size_t part = elements.of(side, seen(other)) == side ? 0 : 1;
    ++met.n_rays.at(part);
    if (other && *other != side) {
      others.at(part).push_back(static_cast<std::uint32_t>(elements.of(*other, own)));
    }
  }
  for (std::size_t part = 0; part < 2; ++part) {
    std::ranges::sort(others.at(part));
    std::vector<RayCount>& counts = met.counts.at(part);
    for (const std::uint32_t other : others.at(part)) {
      if (counts.empty() || counts.back().element != other) {
        counts.push_back({.element = other});
      }
      ++counts.back().n;
    }
  }
  return met;
}

PatchRays::Direct PatchRays::direct_at(const Elements& elements, std::size_t side) const {
  const std::size_t patch = side / 2;
  const CutTriangle& triangle = patches_->triangle_of(patch);
  const PixelSamples numbers = this->numbers(side, of_sides);
  const bool is_split = elements.within(side).has_value();
  const bool goes_on = lights_.is_any_met() || is_split;
  Direct direct;
  Towards towards;
  std::vector<Ray> onward;
  std::vector<Hit> from;
  for (std::uint32_t i = 0; i < kLightSamples; ++i) {
    const Hit hit = on(triangle, !is_back(side), patches_->uv_in(patch, numbers.two(i, point)));
    direct.albedo +=
        diffuse_albedo(bsdf_of(*scene_, hit), cosine_direction(numbers.two(i, eye)));
    if (lights_.size() > 0) {
      ask(hit, i, numbers.two(i, light), towards);
      if (goes_on) {
        onward.push_back(leaving(hit, numbers.two(i, direction)));
        from.push_back(hit);
      }
    }
  }
  direct.albedo /= kLightSamples;
  std::vector<RawHit> hits;
  cast(onward, hits);
  std::vector<std::uint8_t> part(kLightSamples, 0);
  std::array<std::uint32_t, 2> n{};
  for (std::size_t i = 0; i < hits.size(); ++i) {
    const std::optional<std::size_t> other = side_of(onward[i], hits[i]);
    part[i] = elements.of(side, seen(other)) == side ? 0 : 1;
    ++n.at(part[i]);
    if (lights_.is_any_met()) {
      direct.irradiance.at(part[i]) += met_light(from[i], onward[i], hits[i]);
    }
  }
  std::vector<std::uint8_t> blocked(towards.rays.size());
  caster_->are_blocked(towards.rays, RayOrder::scattered, blocked);
  for (std::size_t i = 0; i < blocked.size(); ++i) {
    if (blocked[i] == 0) {
      direct.irradiance.at(part[towards.sample[i]]) += towards.arrives[i];
    }
  }
  for (std::size_t k = 0; k < 2; ++k) {
    direct.irradiance.at(k) /= is_split ? std::max(n.at(k), 1U) : kLightSamples;
  }
  return direct;
}

/// Puts a ray to a point of a light among those that wait.
void PatchRays::ask(const Hit& hit, std::uint32_t sample_number, const Vector2d& square,
                    Towards& towards) const {
  const std::optional<ChosenLight> chosen =
      lights_.choose({.point = hit.point, .normal = hit.flat_normal}, square);
  if (!chosen) {
    return;
  }
  const double light_offset = light_offsets_[chosen->index];
  const LightSample sample = render::sample(lights_[chosen->index], hit.point, chosen->square);
  const double cosine = hit.flat_normal.dot(sample.direction);
  if (!sample.is_found || !(sample.distance_mm > nearest_asked(hit.offset_mm, light_offset)) ||
      !(cosine > 0.0)) {
    return;
  }
  const double asked = chosen->probability * sample.density;
  const double weight = !sample.is_delta && lights_.is_met(chosen->index)
                            ? power_heuristic(asked, cosine * std::numbers::inv_pi)
                            : 1.0;
  towards.rays.push_back(light_ray(hit, sample, light_offset));
  towards.sample.push_back(sample_number);
  towards.arrives.emplace_back(weight * cosine / asked * sample.radiance);
}

/// The irradiance of a light that a ray by the cosine law has met: pi L, weighted.
Vector3d PatchRays::met_light(const Hit& from, const Ray& ray, const RawHit& raw) const {
  std::optional<std::size_t> met = lights_.environment();
  LightHit at{.direction = ray.direction,
              .distance_mm = std::numeric_limits<double>::infinity(),
              .cosine = 1.0};
  Vector3d radiance = Vector3d::Zero();
  if (raw.is_hit()) {
    met = lights_.of_surface(raw.mesh);
    if (!met) {
      return Vector3d::Zero();
    }
    const Hit hit = caster_->surface_at(ray, raw);
    at.distance_mm = hit.distance_mm;
    at.cosine = -hit.flat_normal.dot(ray.direction);
    radiance = hit.is_front ? lights_.radiance_of_surface(raw.mesh) : Vector3d::Zero();
  } else if (met) {
    radiance = std::get<EnvironmentSourceLight>(lights_[*met]).light.radiance(ray.direction);
  }
  if (!(radiance.maxCoeff() > 0.0)) {
    return Vector3d::Zero();
  }
  const double asked = at.distance_mm > nearest_asked(from.offset_mm, light_offsets_[*met])
                           ? lights_.probability(*met, {from.point, from.flat_normal}) *
                                 density(lights_[*met], from.point, at)
                           : 0.0;
  const double followed = from.flat_normal.dot(ray.direction) * std::numbers::inv_pi;
  return std::numbers::pi * power_heuristic(followed, asked) * radiance;
}

Vector3d PatchRays::arriving(const Elements& elements, const CutTriangle& triangle,
                             bool is_front, const Vector2d& uv, std::size_t number,
                             const ElementSlopes& light) const {
  const Seen own = 2 * triangle.surface + (is_front ? 0 : 1);
  const Hit hit = on(triangle, is_front, uv);
  const PixelSamples numbers = this->numbers(number, of_vertices);
  std::vector<Ray> rays(n_rays_);
  for (std::uint32_t i = 0; i < n_rays_; ++i) {
    rays[i] = leaving(hit, numbers.two(i, direction));
  }
  std::vector<RawHit> hits;
  cast(rays, hits);
  Vector3d sum = Vector3d::Zero();
  for (std::size_t i = 0; i < rays.size(); ++i) {
    if (!hits[i].is_hit()) {
      continue;
    }
    if (const std::optional<PatchPoint> met = patches_->find(hits[i])) {
      sum += light.radiosity(elements.of(side_of(rays[i], *met), own), *met);
    }
  }
  return sum / n_rays_;
}

}  // namespace haarlight::render
