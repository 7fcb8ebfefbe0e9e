// SPDX-License-Identifier: Apache-2.0
/// @file
/// Rays, seconds and error of direct light as it is computed, against its definition (every
/// light by all strata), on every STEP-th pixel of a rig's camera; the table of
/// docs/numerics/direct-light.md. One thread.
///
///     direct_light_cost RIG.toml SCENE.toml [STEP [STRATA]]

#include <algorithm>
#include <cmath>
#include <ctime>
#include <exception>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"

namespace haarlight::render {
namespace {

struct Point {
  SurfacePoint surface;
  std::uint64_t key;
};

struct Evaluated {
  std::vector<LightContribution> all;  ///< (points, lights)
  double seconds = 0.0;
  std::uint64_t n_rays = 0;
};

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

Evaluated evaluate(const DirectLight& direct, const Scene& scene,
                   const std::vector<Point>& points) {
  const auto n_lights = static_cast<std::size_t>(direct.n_lights());
  Evaluated found;
  found.all.resize(points.size() * n_lights);
  const double start = cpu_seconds();
  for (std::size_t i = 0; i < points.size(); ++i) {
    found.n_rays +=
        direct.evaluate(points[i].surface,
                        scene.materials[static_cast<std::size_t>(points[i].surface.material)],
                        points[i].key, std::span(found.all).subspan(i * n_lights, n_lights));
  }
  found.seconds = cpu_seconds() - start;
  return found;
}

int run(const std::string& rig_file, const std::string& scene_file, int step, int strata) {
  const Rig rig = read_rig(rig_file);
  const Scene scene = with_instances_expanded(read_scene(scene_file).scene, scene_file);
  const std::vector<SquareLight> lights = rig_lights(rig);
  const RayCaster caster(scene);
  const CameraModel& camera = rig.cameras.at(0).model;
  std::vector<Point> points;
  for (int y = step / 2; y < camera.height; y += step) {
    for (int x = step / 2; x < camera.width; x += step) {
      if (const auto surface = visible_surface(caster, camera, x + 0.5, y + 0.5)) {
        points.push_back(
            {*surface, hash_key(static_cast<std::uint64_t>(y), static_cast<std::uint64_t>(x))});
      }
    }
  }
  const double start = cpu_seconds();
  const DirectLight direct(caster, lights, {.mixed_grid = strata});
  const double prepared = cpu_seconds() - start;
  const Evaluated found = evaluate(direct, scene, points);
  const Evaluated defined = evaluate(
      DirectLight(caster, lights, {.mixed_grid = strata, .sample_all = true}), scene, points);
  double difference2 = 0.0;
  double norm2 = 0.0;
  double sum = 0.0;
  double worst = 0.0;
  std::size_t n_parted = 0;
  for (std::size_t i = 0; i < defined.all.size(); ++i) {
    const LightContribution& ours = found.all[i];
    const LightContribution& truth = defined.all[i];
    difference2 += std::pow(ours.diffuse - truth.diffuse, 2);
    norm2 += std::pow(truth.diffuse, 2);
    sum += std::abs(ours.visible - truth.visible);
    worst = std::max(worst, std::abs(ours.visible - truth.visible));
    n_parted += truth.visible > 0.0 && truth.visible < 1.0;
  }
  const auto n = static_cast<double>(defined.all.size());
  fmt::print(
      "{} points, {} lights, {:.2f} % of the pairs in penumbra, prepared in {:.3f} s\n"
      "visible fraction: |difference| mean {:.1e}, largest {:.1e}; D: relative L2 {:.1e}\n"
      "rays a point: {:.0f} instead of {:.0f}; CPU ms a point: {:.3f} instead of {:.2f}\n",
      points.size(), lights.size(), 100.0 * static_cast<double>(n_parted) / n, prepared,
      sum / n, worst, std::sqrt(difference2 / norm2),
      static_cast<double>(found.n_rays) / static_cast<double>(points.size()),
      static_cast<double>(defined.n_rays) / static_cast<double>(points.size()),
      1e3 * found.seconds / static_cast<double>(points.size()),
      1e3 * defined.seconds / static_cast<double>(points.size()));
  return 0;
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  try {
    if (argc < 3) {
      fmt::print(stderr, "direct_light_cost RIG.toml SCENE.toml [STEP [STRATA]]\n");
      return 2;
    }
    return haarlight::render::run(argv[1], argv[2], argc > 3 ? std::stoi(argv[3]) : 10,
                                  argc > 4 ? std::stoi(argv[4]) : 16);
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
