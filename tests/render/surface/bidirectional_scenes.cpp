// SPDX-License-Identifier: Apache-2.0
#include "tests/render/surface/bidirectional_scenes.h"

#include <cmath>
#include <functional>
#include <memory>

#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render::testing {

using Eigen::Vector3d;

namespace {

using Make = std::function<std::unique_ptr<TileRenderer>(const RayCaster&, const Camera&,
                                                         std::uint64_t)>;

/// The means over each replicate's picture.
std::vector<Vector3d> replicates_of(const Rendering& rendering, const Make& make,
                                    bool has_splats) {
  const RayCaster caster(*rendering.scene);
  const Camera camera(rendering.model, rendering.optics);
  std::vector<Vector3d> means;
  for (int i = 0; i < rendering.replicates; ++i) {
    const auto integrator = make(caster, camera, static_cast<std::uint64_t>(i));
    Film film(rendering.model.width, rendering.model.height, surface_layers(false, has_splats));
    static_cast<void>(run(*integrator, {.samples = rendering.samples}, film));
    const Image<float> picture = film.mean(0);
    Vector3d sum = Vector3d::Zero();
    for (std::size_t j = 0; j < picture.pixels().size(); ++j) {
      sum[static_cast<Eigen::Index>(j % 3)] += double{picture.pixels()[j]};
    }
    means.emplace_back(sum / (rendering.model.width * rendering.model.height));
  }
  return means;
}

std::vector<Vector3d> replicates_of_paths(const Rendering& rendering, PathOptions options) {
  return replicates_of(
      rendering,
      [&](const RayCaster& caster, const Camera& camera, std::uint64_t seed) {
        options.seed = 7000 + seed;
        return std::make_unique<PathIntegrator>(*rendering.scene, caster, rendering.environment,
                                                camera, options);
      },
      false);
}

PictureMean mean_of(const std::vector<Vector3d>& replicates) {
  PictureMean mean;
  const auto n = static_cast<double>(replicates.size());
  for (const Vector3d& one : replicates) {
    mean.value += one / n;
  }
  Vector3d squares = Vector3d::Zero();
  for (const Vector3d& one : replicates) {
    squares += (one - mean.value).cwiseAbs2();
  }
  mean.error = (squares / (n * (n - 1.0))).cwiseSqrt();
  return mean;
}

}  // namespace

PictureMean mean_of_paths(const Rendering& rendering, PathOptions options) {
  return mean_of(replicates_of_paths(rendering, options));
}

PictureMean mean_of_paths_of(const Rendering& rendering, PathOptions options, int bounces) {
  options.sure_bounces = bounces;  // both follow the same paths
  options.most_bounces = bounces;
  std::vector<Vector3d> replicates = replicates_of_paths(rendering, options);
  options.most_bounces = bounces - 1;
  const std::vector<Vector3d> fewer = replicates_of_paths(rendering, options);
  for (std::size_t i = 0; i < replicates.size(); ++i) {
    replicates[i] -= fewer[i];
  }
  return mean_of(replicates);
}

PictureMean mean_of_bidirectional(const Rendering& rendering, BidirectionalOptions options) {
  options.width = rendering.model.width;
  options.height = rendering.model.height;
  return mean_of(replicates_of(
      rendering,
      [&](const RayCaster& caster, const Camera& camera, std::uint64_t seed) {
        options.seed = seed;
        return std::make_unique<BidirectionalIntegrator>(
            *rendering.scene, caster, rendering.environment, camera, options);
      },
      true));
}

Scene room() {
  Scene scene;
  scene.materials = {
      {.name = "lamp", .kd = Vector3d::Constant(0.3), .emits = Vector3d(9, 7, 5)},
      {.name = "stone", .kd = Vector3d(0.7, 0.6, 0.5)},
      {.name = "plaster",
       .kd = Vector3d::Constant(0.6),
       .bsdf = BsdfKind::oren_nayar,
       .sigma = 0.5},
      {.name = "gloss", .kd = Vector3d::Constant(0.4), .ks = 0.3, .exponent = 20.0},
      {.name = "metal",
       .bsdf = BsdfKind::conductor,
       .roughness = 0.4,
       .eta = Vector3d(0.2, 0.5, 1.1),
       .k = Vector3d(3.0, 2.5, 2.0)},
      {.name = "lacquer",
       .kd = Vector3d::Constant(0.5),
       .bsdf = BsdfKind::coated,
       .roughness = 0.3}};
  const auto quad = [&scene](const Vector3d& a, const Vector3d& b, const Vector3d& c,
                             const Vector3d& d, int material) {
    scene.meshes.push_back(make_quad(a, b, c, d, material));
  };
  quad({-200, -200, 0}, {200, -200, 0}, {200, 200, 0}, {-200, 200, 0}, 1);
  quad({-200, 200, 0}, {200, 200, 0}, {200, 200, 300}, {-200, 200, 300}, 2);
  quad({-200, -200, 0}, {-200, 200, 0}, {-200, 200, 300}, {-200, -200, 300}, 3);
  quad({200, 200, 0}, {200, -200, 0}, {200, -200, 300}, {200, 200, 300}, 5);
  quad({-50, -60, 290}, {-50, 60, 290}, {60, 60, 290}, {60, -60, 290}, 0);
  scene.meshes.push_back(make_sphere({70, 30, 60}, 60.0, 2, 4));
  scene.meshes.push_back(make_sphere({-80, 60, 50}, 50.0, 2, 1));
  return scene;
}

CameraModel room_camera() {
  CameraModel model = square_camera({20, -600, 180}, {0, 0, 120}, 25.0, kBidirectionalSize);
  model.world_from_cam = look_at({20, -600, 180}, {0, 0, 120}, Vector3d::UnitZ());
  return model;
}

}  // namespace haarlight::render::testing
