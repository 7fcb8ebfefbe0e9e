// SPDX-License-Identifier: Apache-2.0
/// @file
/// What exact soft shadows cost beside shadow rays, for all points that a scene's camera sees and its
/// first light: time and error; the table of docs/numerics/soft-shadow.md. One thread, CPU seconds,
/// medians. Rays are stratified and jittered, and go from a point to many as fast as
/// RayCaster::are_blocked() can; their error is the difference from the exact values.
///
///     soft_shadow_cost SCENE.toml [WIDTH HEIGHT] [GRID]

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <exception>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "core/count.h"
#include "core/cpu_time.h"
#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"
#include "render/camera/camera.h"
#include "render/soft_shadow/soft_shadow.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

template <class Function>
double median_seconds(int repeats, const Function& function) {
  std::vector<double> seconds;
  for (int i = 0; i < repeats; ++i) {
    const double begin = thread_cpu_seconds();
    function();
    seconds.push_back(thread_cpu_seconds() - begin);
  }
  std::ranges::sort(seconds);
  return seconds[seconds.size() / 2];
}

std::vector<Vector3d> seen_points(const SceneFile& file, const RayCaster& caster) {
  const Camera camera(file.camera, file.optics);
  std::vector<Vector3d> points;
  for (int y = 0; y < camera.height(); ++y) {
    for (int x = 0; x < camera.width(); ++x) {
      const Ray ray = camera.ray(x + 0.5, y + 0.5, Vector2d(0.5, 0.5));
      const RawHit raw = caster.intersect(ray);
      if (raw.is_hit()) {
        const Hit hit = caster.surface_at(ray, raw);
        points.push_back(hit.point + hit.offset_mm * hit.flat_normal);
      }
    }
  }
  return points;
}

/// (u, v) in [0, 1)^2 on a disk, or on a light of four corners.
Vector3d light_point(const FlatLight& light, double u, double v) {
  Vector2d p;
  if (light.is_disk()) {
    const double angle = 2.0 * std::numbers::pi * v;
    p = std::sqrt(u) * Vector2d(std::cos(angle), std::sin(angle));
  } else {
    const auto& c = light.corners;
    p = c[0] + u * (c[1] - c[0]) + v * (c[3] - c[0]);
  }
  return light.to_world({p.x(), p.y(), 0.0});
}

/// n x n jittered strata, drawn beforehand: a point takes one of kSets, so that nothing but tracing is
/// timed. Adaptive: first 4 x 4, and all where these disagree.
class ShadowRays {
 public:
  ShadowRays(const RayCaster& caster, const FlatLight& light, int n, bool is_adaptive)
      : caster_(caster), light_(light), all_(draw(n, 0)) {
    if (is_adaptive && n > 4) {
      first_ = draw(4, 1);
    }
    blocked_.resize(count(n) * count(n) + 16);
  }

  double visibility(const Vector3d& point, std::uint64_t key) {
    if (light_.to_light(point).z() <= 0.0) {
      return 0.0;
    }
    const std::size_t set = mix_bits(key) % kSets;
    if (!first_.empty()) {
      const double first = seen(point, first_[set]);
      if (first == 0.0 || first == 1.0) {
        return first;
      }
    }
    return seen(point, all_[set]);
  }

 private:
  static constexpr std::size_t kSets = 256;
  using Targets = std::vector<Vector3d>;

  [[nodiscard]] std::vector<Targets> draw(int n, std::uint64_t key) const {
    std::vector<Targets> sets(kSets);
    for (std::size_t set = 0; set < kSets; ++set) {
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          const std::uint64_t hash = hash_key(key, set, static_cast<std::uint64_t>(i * n + j));
          const double u = uniform_unit(hash);
          const double v = uniform_unit(mix_bits(hash));
          sets[set].push_back(light_point(light_, (i + u) / n, (j + v) / n));
        }
      }
    }
    return sets;
  }

  double seen(const Vector3d& point, const Targets& targets) {
    const auto blocked = std::span(blocked_).first(targets.size());
    caster_.are_blocked(point, targets, blocked);
    return 1.0 - static_cast<double>(std::ranges::count(blocked, std::uint8_t{1})) /
                     static_cast<double>(targets.size());
  }

  const RayCaster& caster_;
  const FlatLight& light_;
  std::vector<Targets> all_;
  std::vector<Targets> first_;
  std::vector<std::uint8_t> blocked_;
};

struct Errors {
  double mean = 0.0;  ///< |difference| over points in the penumbra
  double at_99 = 0.0;
  double seconds = 0.0;  ///< of all points
};

Errors errors_of(ShadowRays rays, const std::vector<Vector3d>& points,
                 const std::vector<LightShadow>& exact) {
  Errors errors;
  std::vector<double> values(points.size());
  errors.seconds = median_seconds(3, [&] {
    for (std::size_t i = 0; i < points.size(); ++i) {
      values[i] = rays.visibility(points[i], i);
    }
  });
  std::vector<double> off;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (exact[i].visibility > 0.0F && exact[i].visibility < 1.0F) {
      off.push_back(std::abs(values[i] - exact[i].visibility));
      errors.mean += off.back();
    }
  }
  if (!off.empty()) {
    std::ranges::sort(off);
    errors.mean /= static_cast<double>(off.size());
    errors.at_99 = off[off.size() * 99 / 100];
  }
  return errors;
}

void run(const std::string& path, int width, int height, int grid) {
  SceneFile file = read_scene(path);
  if (width > 0) {
    file.camera = resized(file.camera, width, height);
  }
  file.scene = with_instances_expanded(std::move(file.scene), path);
  const RayCaster caster(file.scene);
  const OccluderEdges edges = occluder_edges(file.scene.meshes);
  const FlatLight light = flat_lights(file.scene, LightShape::own, path).front();
  std::vector<Vector3d> points = seen_points(file, caster);
  std::vector<LightShadow> exact(points.size());
  ShadowCounts counts;
  const double ours = median_seconds(5, [&] {
    SoftShadow soft(file.scene, edges, caster, light, {.grid = grid}, path);
    soft.evaluate(points, exact);
    counts = soft.counts();
  });
  const double per_point = 1e6 / static_cast<double>(points.size());
  fmt::print("{}: {} points, {} in the penumbra, {} edges, {} listed\n", path, points.size(),
             counts.n_penumbra, counts.n_edges, counts.n_listed);
  fmt::print("{:<22} {:>10} {:>9} {:>9} {:>10}\n", "", "us a point", "mean", "99 %",
             "times ours");
  fmt::print("{:<22} {:>10.3f} {:>9} {:>9} {:>10}\n", "exact, grid and all", ours * per_point,
             "-", "-", 1);
  std::vector<std::uint8_t> blocked(points.size());
  std::vector<Ray> centre;
  for (const Vector3d& point : points) {
    centre.push_back({.origin = point, .direction = light.centre - point, .t_max = 0.999});
  }
  const double one =
      median_seconds(5, [&] { caster.are_blocked(centre, RayOrder::coherent, blocked); });
  fmt::print("{:<22} {:>10.3f} {:>9} {:>9} {:>10.2f}\n", "one ray each, the limit",
             one * per_point, "", "", one / ours);
  // Of many rays a part of the points: the same time each.
  std::vector<Vector3d> some;
  std::vector<LightShadow> of_some;
  constexpr std::size_t kStep = 7;
  for (std::size_t i = 0; i < points.size(); i += kStep) {
    some.push_back(points[i]);
    of_some.push_back(exact[i]);
  }
  for (const bool is_adaptive : {false, true}) {
    bool is_reached = false;
    for (const int n : {2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 16, 20, 24, 32}) {
      const bool is_last = n == 32;
      if (is_reached && !is_last) {
        continue;
      }
      const Errors errors = errors_of({caster, light, n, is_adaptive}, some, of_some);
      const bool is_first = !is_reached && errors.mean <= 0.01;
      is_reached = is_reached || is_first;
      if (is_first || is_last) {
        const double seconds = errors.seconds * static_cast<double>(points.size()) /
                               static_cast<double>(some.size());
        fmt::print("{:<22} {:>10.3f} {:>9.5f} {:>9.5f} {:>10.1f}\n",
                   fmt::format("{} rays{}{}", n * n, is_adaptive ? ", after 16" : "",
                               is_first ? ", the fewest" : ""),
                   seconds * per_point, errors.mean, errors.at_99, seconds / ours);
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  try {
    const haarlight::ThreadLimit one(1);
    if (argc != 2 && argc != 4 && argc != 5) {
      fmt::print(stderr, "soft_shadow_cost SCENE.toml [WIDTH HEIGHT] [GRID]\n");
      return 2;
    }
    haarlight::render::run(argv[1], argc >= 4 ? std::stoi(argv[2]) : 0,
                           argc >= 4 ? std::stoi(argv[3]) : 0,
                           argc == 5 ? std::stoi(argv[4]) : 256);
  } catch (const std::exception& error) {
    fmt::print(stderr, "soft_shadow_cost: {}\n", error.what());
    return 1;
  }
  return 0;
}
