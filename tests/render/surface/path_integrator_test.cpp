// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_integrator.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/render/direct/direct_light.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

CameraModel camera(const Vector3d& eye, const Vector3d& target, double fov_deg, int size) {
  CameraModel model;
  model.width = size;
  model.height = size;
  model.world_from_cam = look_at(eye, target, Vector3d(0.1, 1.0, 0.2));
  model.fx = 0.5 * size / std::tan(0.5 * fov_deg * pi / 180.0);
  model.fy = model.fx;
  model.cx = 0.5 * size;
  model.cy = 0.5 * size;
  return model;
}

/// Mean of a picture and its standard error, of red.
struct Mean {
  double value = 0.0;
  double error = 0.0;
};
Mean mean_of(const Film& film) {
  const Image<float> picture = film.mean();
  const Image<float> error = film.standard_error();
  Mean mean;
  const double n = static_cast<double>(film.width()) * film.height();
  for (int y = 0; y < film.height(); ++y) {
    for (int x = 0; x < film.width(); ++x) {
      mean.value += picture(y, x) / n;
      mean.error += error(y, x) / n * (error(y, x) / n);
    }
  }
  mean.error = std::sqrt(mean.error);
  return mean;
}

Film render(const Scene& scene, const CameraModel& model, const PathOptions& options,
            std::uint32_t samples) {
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, model, options);
  Film film(model.width, model.height);
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return film;
}

/// A closed box that looks inwards, every wall emits and reflects the same.
Scene furnace(double albedo) {
  Scene scene;
  scene.materials.push_back(
      {.name = "wall", .kd = Vector3d::Constant(albedo), .emits = Vector3d::Constant(2.0)});
  Mesh box = make_box({-100, -100, -100}, {100, 150, 80}, 0);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  scene.meshes.push_back(box);
  return scene;
}

TEST(PathIntegrator, AFurnaceShowsTheSameInAllDirections) {
  for (const SamplerKind sampler : {SamplerKind::independent, SamplerKind::sobol}) {
    for (const double albedo : {0.0, 0.5, 0.9}) {
      PathOptions options;
      options.sampler = sampler;
      options.most_bounces = 2000;
      const Film film = render(furnace(albedo), camera({10, 5, 0}, {50, 90, 20}, 70.0, 32),
                               options, albedo == 0.9 ? 256 : 64);
      const Mean mean = mean_of(film);
      const double truth = 2.0 / (1.0 - albedo);
      EXPECT_LE(mean.error, 2e-3 * truth) << "weak: it would see no error of 1 %";
      EXPECT_NEAR(mean.value, truth, 4.0 * mean.error + 1e-12)
          << to_string(sampler) << ' ' << albedo;
    }
  }
}

TEST(PathIntegrator, AFurnaceCutAtABounceIsTheGeometricSum) {
  for (const int bounces : {0, 1, 2, 5}) {
    PathOptions options;
    options.most_bounces = bounces;
    options.sure_bounces = 100;
    const Mean mean =
        mean_of(render(furnace(0.8), camera({10, 5, 0}, {50, 90, 20}, 70.0, 32), options, 64));
    const double truth = 2.0 * (1.0 - std::pow(0.8, bounces + 1)) / (1.0 - 0.8);
    EXPECT_LE(mean.error, 2e-3 * truth);
    EXPECT_NEAR(mean.value, truth, 4.0 * mean.error + 1e-6) << bounces;
  }
}

/// A floor under a square light, a box between them.
struct Lit {
  Scene scene;
  SquareLight light;
};
Lit lit_floor(const Material& material, bool has_box) {
  Lit lit;
  lit.scene.materials = {material,
                         {.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d(3, 2, 1)},
                         {.name = "box", .kd = Vector3d::Zero()}};
  lit.scene.meshes.push_back(
      make_quad({-500, -500, 0}, {500, -500, 0}, {500, 500, 0}, {-500, 500, 0}, 0));
  // Down is its front: clockwise from above.
  lit.scene.meshes.push_back(
      make_quad({-60, -40, 300}, {-60, 40, 300}, {60, 40, 300}, {60, -40, 300}, 1));
  if (has_box) {
    lit.scene.meshes.push_back(make_box({-90, -50, 100}, {25, 80, 120}, 2));
  }
  lit.light.centre = {0, 0, 300};
  lit.light.width_mm = 120;
  lit.light.height_mm = 80;
  lit.light.radiance = 3.0;
  return lit;
}

TEST(PathIntegrator, DirectLightIsThatOfTheVirtualRig) {
  const std::vector<Material> materials = {
      {.name = "matte", .kd = Vector3d::Constant(0.7)},
      {.name = "gloss", .kd = Vector3d::Constant(0.3), .ks = 0.4, .exponent = 20.0},
      {.name = "mirror-like", .kd = Vector3d::Zero(), .ks = 0.6, .exponent = 300.0}};
  for (const Material& material : materials) {
    for (const bool has_box : {false, true}) {
      const Lit lit = lit_floor(material, has_box);
      // One spot, so small that it is a point.
      const Vector3d target(40, 30, 0);
      const CameraModel model = camera({75, 58, 260}, target, 0.001, 8);
      PathOptions options;
      options.most_bounces = 1;
      const Mean mean = mean_of(render(lit.scene, model, options, 6144));

      const RayCaster caster(lit.scene);
      DirectLightOptions exact;
      exact.mixed_grid = 64;
      const DirectLight direct(caster, std::vector<SquareLight>{lit.light}, exact);
      SurfacePoint surface;
      surface.point = target;
      surface.normal = Vector3d::UnitZ();
      surface.flat_normal = Vector3d::UnitZ();
      surface.to_eye = (model.centre_world() - target).normalized();
      LightContribution contribution;
      direct.evaluate(surface, material, 1, {&contribution, 1});
      const double truth =
          material.kd.x() * contribution.diffuse + material.ks * contribution.specular;
      ASSERT_GT(truth, 0.0);
      EXPECT_LE(mean.error, 2e-3 * truth) << "weak: it would see no error of 1 %";
      // The truth's own: 64 x 64 strata in the penumbra.
      const double own = has_box ? 1e-3 * truth : 1e-5 * truth;
      EXPECT_NEAR(mean.value, truth, 4.0 * mean.error + own) << material.name << ' ' << has_box;
    }
  }
}

TEST(PathIntegrator, OnlyTheFrontOfALightShines) {
  const Lit lit = lit_floor({.name = "floor", .kd = Vector3d::Constant(0.5)}, false);
  PathOptions options;
  options.most_bounces = 0;
  const Image<float> above =
      render(lit.scene, camera({0, 0, 600}, {0, 0, 300}, 5.0, 4), options, 4).mean();
  const Image<float> below =
      render(lit.scene, camera({0, 0, 100}, {0, 0, 300}, 5.0, 4), options, 4).mean();
  for (int i = 0; i < 16; ++i) {
    EXPECT_EQ(above(i / 4, i % 4, 0), 0.0F);
    EXPECT_EQ(below(i / 4, i % 4, 0), 3.0F);
    EXPECT_EQ(below(i / 4, i % 4, 2), 1.0F);
  }
}

TEST(PathIntegrator, SobolConvergesFasterThanIndependentSamples) {
  const Lit lit = lit_floor({.name = "floor", .kd = Vector3d::Constant(0.5)}, false);
  const CameraModel model = camera({-80, -70, 280}, {40, 30, 0}, 30.0, 16);
  const auto rms = [&](SamplerKind sampler, std::uint32_t samples) {
    PathOptions options;
    options.most_bounces = 1;
    options.sampler = sampler;
    const Image<float> found = render(lit.scene, model, options, samples).mean();
    options.seed = 99;
    options.sampler = SamplerKind::sobol;
    const Image<float> truth = render(lit.scene, model, options, 4096).mean();
    double sum = 0.0;
    for (std::size_t i = 0; i < found.pixels().size(); ++i) {
      const double difference = found.pixels()[i] - truth.pixels()[i];
      sum += difference * difference;
    }
    return std::sqrt(sum);
  };
  EXPECT_LT(rms(SamplerKind::sobol, 64), 0.5 * rms(SamplerKind::independent, 64));
}

TEST(PathIntegrator, TheSameForAnyThreadsAndPasses) {
  const Scene scene = furnace(0.7);
  const CameraModel model = camera({10, 5, 0}, {50, 90, 20}, 70.0, 70);
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, model, {});
  Film whole(model.width, model.height);
  (void)run(integrator, {.samples = 7}, whole);
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    Film film(model.width, model.height);
    (void)run(integrator, {.samples = 7}, film);
    EXPECT_TRUE(std::ranges::equal(film.mean().pixels(), whole.mean().pixels()));
    EXPECT_TRUE(
        std::ranges::equal(film.standard_error().pixels(), whole.standard_error().pixels()));
  }
  // Tiles of other shapes, samples one by one.
  Film pieces(model.width, model.height);
  for (std::uint32_t sample = 0; sample < 7; ++sample) {
    for (int x0 = 0; x0 < 70; x0 += 9) {
      integrator.render_tile({.x0 = x0, .y0 = 0, .x1 = std::min(x0 + 9, 70), .y1 = 70},
                             {.first = sample, .end = sample + 1}, pieces);
    }
  }
  EXPECT_TRUE(std::ranges::equal(pieces.mean().pixels(), whole.mean().pixels()));
}

TEST(TileRenderer, StopsAtTheErrorAndSaysIt) {
  const Scene scene = furnace(0.5);
  const CameraModel model = camera({10, 5, 0}, {50, 90, 20}, 70.0, 16);
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, model, {});
  Film film(model.width, model.height);
  const RunResult found = run(integrator, {.relative_l2 = 0.02}, film);
  EXPECT_LE(found.error.relative_l2, 0.02);
  EXPECT_GE(found.samples, 16U);
  Film shorter(model.width, model.height);
  const RunResult half = run(integrator, {.samples = found.samples / 4}, shorter);
  EXPECT_GT(half.error.relative_l2, 0.02);
}

}  // namespace
}  // namespace haarlight::render
