// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_baselines.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <utility>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "render/bsdf/shading_frame.h"
#include "render/sampling/warp.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

enum Question : std::uint32_t { roulette = SampleNumbers::first_own, next_point };

}  // namespace

NaivePathIntegrator::NaivePathIntegrator(const Scene& scene, const RayCaster& caster,
                                         const Environment* environment, Camera camera,
                                         const PathBaselineOptions& options)
    : RayIntegrator(scene, caster, environment, std::move(camera), options.ray),
      options_(options) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0 && options.sure_bounces >= 0,
                    "bounces are counted from 0");
}

Vector3d NaivePathIntegrator::radiance(const Ray& ray, const SampleNumbers& numbers,
                                       std::uint64_t& n_rays) const {
  Vector3d sum = Vector3d::Zero();
  for (int bounces = 0; bounces <= options_.most_bounces; ++bounces) {
    sum += after(bounces, ray, numbers, n_rays);
  }
  return sum;
}

/// What a new path finds at its vertex after so many bounces: what it emits, where the path could not
/// have asked for it, and what lights send there.
Vector3d NaivePathIntegrator::after(int bounces, Ray ray, const SampleNumbers& numbers,
                                    std::uint64_t& n_rays) const {
  Vector3d throughput = Vector3d::Ones();
  double radiance_scale = 1.0;
  bool is_found_by_chance = true;  // a light there: no vertex before could ask for it
  for (int bounce = 0;; ++bounce) {
    const int own = bounces * (bounces + 1) / 2 + bounce;  // numbers of this path alone
    const RawHit raw = caster().intersect(ray);
    ++n_rays;
    if (!raw.is_hit()) {
      return bounce == bounces && is_found_by_chance
                 ? Vector3d(throughput.cwiseProduct(emitted_from_afar(ray)))
                 : Vector3d::Zero();
    }
    const SurfacePoint at = surface_at(ray, raw);
    if (bounce == bounces) {
      Vector3d sum = is_found_by_chance ? emitted(at.hit) : Vector3d::Zero();
      if (bounces < options_.most_bounces && has_smooth_part(at.bsdf)) {
        sum += direct_light(at, numbers, own, n_rays);
      }
      return throughput.cwiseProduct(sum);
    }
    const std::optional<BsdfSample> next =
        go_on(at, numbers.one(own, SampleNumbers::lobe),
              numbers.two(own, SampleNumbers::direction_to_go), ray);
    if (!next) {
      return Vector3d::Zero();
    }
    throughput = throughput.cwiseProduct(next->weight);
    radiance_scale *= next->radiance_scale;
    is_found_by_chance = next->is_delta;
    if (bounce >= options_.sure_bounces) {
      const double survives = std::min(1.0, throughput.maxCoeff() / radiance_scale);
      if (!(numbers.one(own, roulette) < survives)) {
        return Vector3d::Zero();
      }
      throughput /= survives;
    }
  }
}

SurfacePoints::SurfacePoints(const Scene& scene) {
  std::uint32_t surface = 0;
  for (const Mesh& mesh : scene.meshes) {
    add_mesh(mesh, surface++);
  }
  for (const Sphere& sphere : scene.spheres) {
    add({.shape = Shape::sphere,
         .surface = surface++,
         .at = sphere.centre,
         .radius_mm = sphere.radius_mm},
        4.0 * std::numbers::pi * sphere.radius_mm * sphere.radius_mm);
  }
  for (const Disk& disk : scene.disks) {
    const Eigen::Matrix3d frame = frame_of(disk.normal);
    add({.shape = Shape::disk,
         .surface = surface++,
         .at = disk.centre,
         .u = disk.radius_mm * frame.col(0),
         .v = disk.radius_mm * frame.col(1)},
        std::numbers::pi * disk.radius_mm * disk.radius_mm);
  }
  for (const Instance& instance : scene.instances) {
    add_mesh(mesh_of(scene, instance), surface++);
  }
}

void SurfacePoints::add(const Piece& piece, double area) {
  if (area > 0.0) {
    pieces_.push_back(piece);
    up_to_.push_back(area_mm2() + area);
  }
}

void SurfacePoints::add_mesh(const Mesh& mesh, std::uint32_t surface) {
  for (const Eigen::Vector3i& corners : mesh.triangles) {
    const auto corner = [&](int i) {
      return mesh.vertices[static_cast<std::size_t>(corners[i])];
    };
    const Vector3d u = corner(1) - corner(0);
    const Vector3d v = corner(2) - corner(0);
    add({.surface = surface, .at = corner(0), .u = u, .v = v}, 0.5 * u.cross(v).norm());
  }
}

SurfacePoints::Point SurfacePoints::draw(const Vector2d& square) const {
  const CutUnit cut = cut_unit(up_to_, square.x());
  const Piece& piece = pieces_[cut.index];
  const Vector2d within(cut.within, square.y());
  Vector3d point = piece.at;
  switch (piece.shape) {
    case Shape::triangle: {
      const double root = std::sqrt(within.x());
      point += root * (1.0 - within.y()) * piece.u + root * within.y() * piece.v;
      break;
    }
    case Shape::sphere: {
      const double z = 1.0 - 2.0 * within.x();
      const double r = piece.radius_mm * std::sqrt(std::max(0.0, 1.0 - z * z));
      const Vector2d around = r * at_turns(within.y());
      point += Vector3d(around.x(), around.y(), piece.radius_mm * z);
      break;
    }
    case Shape::disk: {
      const Vector2d on_disk = concentric_disk(within);
      point += on_disk.x() * piece.u + on_disk.y() * piece.v;
      break;
    }
  }
  return {.surface = piece.surface, .point = point};
}

AreaPathIntegrator::AreaPathIntegrator(const Scene& scene, const RayCaster& caster,
                                       const Environment* environment, Camera camera,
                                       const PathBaselineOptions& options)
    : RayIntegrator(scene, caster, environment, std::move(camera), options.ray),
      points_(scene),
      most_bounces_(options.most_bounces) {
  HAARLIGHT_EXPECTS(options.most_bounces >= 0, "bounces are counted from 0");
}

Vector3d AreaPathIntegrator::radiance(const Ray& first, const SampleNumbers& numbers,
                                      std::uint64_t& n_rays) const {
  Ray ray = first;
  RawHit raw = caster().intersect(ray);
  ++n_rays;
  if (!raw.is_hit()) {
    return emitted_from_afar(ray);
  }
  Vector3d throughput = Vector3d::Ones();
  Vector3d sum = Vector3d::Zero();
  for (int bounce = 0;; ++bounce) {
    const SurfacePoint at = surface_at(ray, raw);
    if (bounce == 0) {
      sum += emitted(at.hit);
    } else {
      const double cosine = std::abs(at.hit.flat_normal.dot(ray.direction));
      throughput *= cosine / (at.hit.distance_mm * at.hit.distance_mm);
    }
    if (bounce == most_bounces_) {
      return sum;
    }
    sum += throughput.cwiseProduct(direct_light(at, numbers, bounce, n_rays));
    // The next vertex, wherever it is: p_A = 1/(area of all).
    const SurfacePoints::Point next = points_.draw(numbers.two(bounce, next_point));
    const Vector3d origin = at.hit.point + at.hit.offset_mm * at.hit.flat_normal;
    const Vector3d way = next.point - origin;
    const double distance = way.norm();
    ray = {.origin = origin, .direction = way / distance};
    const Vector3d to_next = at.world_from_local.transpose() * ray.direction;
    const Vector3d f = evaluate(at.bsdf, at.to_eye, to_next);
    if (!(f.maxCoeff() > 0.0) || !(at.hit.flat_normal.dot(ray.direction) > 0.0)) {
      return sum;
    }
    raw = caster().intersect(ray);
    ++n_rays;
    constexpr double kSame = 1e-5;  // of the way: rounding in single precision
    if (raw.mesh != next.surface ||
        !(std::abs(double{raw.t} - distance) <= kSame * distance + at.hit.offset_mm)) {
      return sum;  // something else is in the way
    }
    throughput = points_.area_mm2() * to_next.z() * throughput.cwiseProduct(f);
  }
}

}  // namespace haarlight::render
