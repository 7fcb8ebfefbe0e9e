// SPDX-License-Identifier: Apache-2.0
/// @file
/// Paths over mirrors, glass and coats, where the picture is known.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "render/bsdf/fresnel.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;

constexpr double kEmitted = 2.0;
/// Of a difference of means in standard errors; one in 15 000 honest comparisons is beyond. With
/// some 20 of them here: one in 800 runs with other seeds. The seeds are fixed.
constexpr double kMostDeviations = 4.0;

CameraModel camera(const Vector3d& eye, const Vector3d& target, double fov_deg, int size) {
  CameraModel model;
  model.width = size;
  model.height = size;
  model.world_from_cam = look_at(eye, target, Vector3d(0.1, 1.0, 0.2));
  model.fx = 0.5 * size / std::tan(0.5 * fov_deg * std::numbers::pi / 180.0);
  model.fy = model.fx;
  model.cx = 0.5 * size;
  model.cy = 0.5 * size;
  return model;
}

/// Of red.
struct Mean {
  double value = 0.0;
  double error = 0.0;
  double lowest = 1e300;
  double highest = 0.0;
};
Mean render(const Scene& scene, const CameraModel& model, const PathOptions& options,
            std::uint32_t samples) {
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, nullptr, model, options);
  Film film(model.width, model.height, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  const Image<float> picture = film.mean(0);
  const Image<float> error = film.standard_error(0);
  Mean mean;
  const double n = static_cast<double>(film.width()) * film.height();
  for (int y = 0; y < film.height(); ++y) {
    for (int x = 0; x < film.width(); ++x) {
      const double value = picture(y, x);
      mean.value += value / n;
      mean.error += error(y, x) / n * (error(y, x) / n);
      mean.lowest = std::min(mean.lowest, value);
      mean.highest = std::max(mean.highest, value);
    }
  }
  mean.error = std::sqrt(mean.error);
  return mean;
}

/// A closed box that looks inwards and emits everywhere.
Scene furnace(double albedo) {
  Scene scene;
  scene.materials.push_back({.name = "wall",
                             .kd = Vector3d::Constant(albedo),
                             .emits = Vector3d::Constant(kEmitted)});
  Mesh box = make_box({-300, -300, -300}, {300, 300, 300}, 0);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  scene.meshes.push_back(box);
  return scene;
}

void add(Scene& scene, const Material& material, Mesh mesh) {
  mesh.material = static_cast<int>(scene.materials.size());
  scene.materials.push_back(material);
  scene.meshes.push_back(std::move(mesh));
}

const Material kMirror{.name = "mirror", .bsdf = BsdfKind::mirror};
Material glass(double ior) {
  return {.name = "glass", .bsdf = BsdfKind::dielectric, .ior = ior};
}

const Vector3d kEye(20, -250, 60);
const Vector3d kCentre(0, 0, 0);

PathOptions options() {
  PathOptions found;
  found.sure_bounces = 0;  // roulette from the start: it must not end a path within glass
  found.most_bounces = 1000;
  return found;
}

TEST(SpecularPaths, AFurnaceShowsNothingOfWhatLosesNoLight) {
  // Each path ends at a wall and has lost nothing: each pixel is what is emitted, to the last bits
  // of a float, without noise.
  const Mesh box = make_box({-80, -60, -70}, {80, 60, 70}, 0);
  const Mesh smooth = make_sphere(kCentre, 100.0, 3, 0);
  Mesh faceted = smooth;
  faceted.normals.clear();
  const auto expect_nothing = [](const Material& material, const Mesh& mesh) {
    Scene scene = furnace(0.0);
    add(scene, material, mesh);
    const Mean mean = render(scene, camera(kEye, kCentre, 40.0, 32), options(), 16);
    EXPECT_NEAR(mean.lowest, kEmitted, 1e-6) << material.name << material.ior;
    EXPECT_NEAR(mean.highest, kEmitted, 1e-6) << material.name << material.ior;
  };
  for (const Mesh& mesh : {box, faceted}) {
    for (const Material& material : {kMirror, glass(1.0), glass(1.5), glass(4.0)}) {
      expect_nothing(material, mesh);
    }
  }
  expect_nothing(kMirror, smooth);
  expect_nothing(glass(1.0), smooth);
}

TEST(SpecularPaths, InterpolatedNormalsLoseLittleAtTheRimOfGlass) {
  // By Snell's law no ray that enters a body is trapped in it. With normals that are not the
  // triangles' some rays that graze the rim are, and end at the longest path.
  for (const double ior : {1.5, 4.0}) {
    Scene scene = furnace(0.0);
    add(scene, glass(ior), make_sphere(kCentre, 100.0, 3, 0));
    const Mean mean = render(scene, camera(kEye, kCentre, 40.0, 32), options(), 16);
    EXPECT_GE(mean.value, 0.997 * kEmitted);
    EXPECT_LE(mean.highest, kEmitted + 1e-6);
  }
}

TEST(SpecularPaths, AFurnaceThatReflectsShowsTheSameEverywhere) {
  for (const Material& material : {kMirror, glass(1.5)}) {
    Scene scene = furnace(0.5);
    add(scene, material, make_sphere(kCentre, 100.0, 3, 0));
    const Mean mean = render(scene, camera(kEye, kCentre, 60.0, 32), options(), 128);
    const double truth = kEmitted / (1.0 - 0.5);
    EXPECT_LE(mean.error, 2e-3 * truth) << "weak: it would see no error of 1 %";
    EXPECT_NEAR(mean.value, truth, kMostDeviations * mean.error) << material.name;
  }
}

TEST(SpecularPaths, AFurnaceShowsNothingOfWhiteRoughOnes) {
  const Material plaster{
      .name = "plaster", .kd = Vector3d::Ones(), .bsdf = BsdfKind::oren_nayar, .sigma = 0.6};
  const Material lacquer{
      .name = "lacquer", .kd = Vector3d::Ones(), .bsdf = BsdfKind::coated, .roughness = 0.2};
  for (const Material& material : {plaster, lacquer}) {
    Scene scene = furnace(0.0);
    Mesh box = make_box({-80, -60, -70}, {80, 60, 70}, 0);
    add(scene, material, box);
    const Mean mean = render(scene, camera(kEye, kCentre, 15.0, 32), options(), 64);
    EXPECT_LE(mean.error, 2e-3 * kEmitted);
    // The coat's table loses up to 3.4 %, here 1 % at most.
    const double lost = material.bsdf == BsdfKind::coated ? 0.01 * kEmitted : 0.0;
    EXPECT_LE(mean.value, kEmitted + kMostDeviations * mean.error) << material.name;
    EXPECT_GE(mean.value, kEmitted - kMostDeviations * mean.error - lost) << material.name;
  }
}

TEST(SpecularPaths, AMirrorShowsItsReflectance) {
  Scene scene = furnace(0.0);
  add(scene,
      {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = Vector3d(0.25, 0.5, 0.75)},
      make_box({-80, -60, -70}, {80, 60, 70}, 0));
  const Mean mean = render(scene, camera(kEye, kCentre, 10.0, 8), PathOptions{}, 4);
  EXPECT_NEAR(mean.lowest, 0.25 * kEmitted, 1e-6);
  EXPECT_NEAR(mean.highest, 0.25 * kEmitted, 1e-6);
}

TEST(SpecularPaths, WithinGlassRadianceIsLargerByTheIndexSquared) {
  // In equilibrium L/n^2 is the same everywhere. From the middle of a ball no ray is totally
  // reflected.
  for (const double ior : {1.5, 2.0}) {
    Scene scene = furnace(0.0);
    add(scene, glass(ior), make_sphere(kCentre, 100.0, 3, 0));
    const Mean mean = render(scene, camera({1, 2, 3}, {80, 10, 20}, 60.0, 16), options(), 16);
    EXPECT_NEAR(mean.lowest, kEmitted * ior * ior, 1e-5);
    EXPECT_NEAR(mean.highest, kEmitted * ior * ior, 1e-5);
  }
}

/// A light as large as a room above a floor; a plate may be between.
Scene lit_floor() {
  Scene scene;
  scene.materials = {
      {.name = "floor", .kd = Vector3d::Constant(0.7)},
      {.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(kEmitted)}};
  scene.meshes.push_back(
      make_quad({-500, -500, 0}, {500, -500, 0}, {500, 500, 0}, {-500, 500, 0}, 0));
  // Down is its front: clockwise from above.
  scene.meshes.push_back(
      make_quad({-400, -400, 300}, {-400, 400, 300}, {400, 400, 300}, {400, -400, 300}, 1));
  return scene;
}

TEST(SpecularPaths, APlateOfIndexOneChangesNothing) {
  const CameraModel floor = camera({75, 58, 150}, {40, 30, 0}, 5.0, 8);
  const CameraModel light = camera({75, 58, 150}, {40, 30, 300}, 5.0, 8);
  const Mean without = render(lit_floor(), floor, PathOptions{}, 1024);
  ASSERT_LE(without.error, 2e-3 * without.value);
  // Above the camera: between floor and light. Below it: between camera and floor.
  for (const double z : {200.0, 50.0}) {
    Scene scene = lit_floor();
    add(scene, glass(1.0), make_box({-900, -900, z}, {900, 900, z + 10.0}, 0));
    const Mean with = render(scene, floor, PathOptions{}, 2048);
    EXPECT_LE(with.error, 5e-3 * without.value) << "weak: it would see no error of 2 %";
    EXPECT_NEAR(with.value, without.value,
                kMostDeviations * std::hypot(with.error, without.error))
        << z;
  }
  Scene scene = lit_floor();
  add(scene, glass(1.0), make_box({-900, -900, 200}, {900, 900, 210}, 0));
  const Mean seen = render(scene, light, PathOptions{}, 4);
  EXPECT_EQ(seen.lowest, kEmitted);
  EXPECT_EQ(seen.highest, kEmitted);
}

TEST(SpecularPaths, APlateOfGlassLetsThroughWhatStokesSays) {
  // (1 - F)/(1 + F): the sum over all reflections within. Nothing else shines.
  Scene scene = lit_floor();
  scene.materials[0].kd.setZero();
  add(scene, glass(1.5), make_box({-900, -900, 200}, {900, 900, 210}, 0));
  for (const Vector3d& eye : {Vector3d(0, 0, 100), Vector3d(-150, 0, 100)}) {
    const Vector3d target(0.0, 0.0, 300.0);
    const double f = fresnel_dielectric((target - eye).normalized().z(), 1.5);
    const Mean mean = render(scene, camera(eye, target, 0.01, 16), options(), 1024);
    const double truth = kEmitted * (1.0 - f) / (1.0 + f);
    EXPECT_LE(mean.error, 2e-3 * truth);
    EXPECT_NEAR(mean.value, truth, kMostDeviations * mean.error) << eye.x();
  }
}

TEST(PathIntegrator, RouletteDoesNotDependOnTheLobe) {
  // Where the coat mirrors no light and the base reflects some: a roulette that asked the number by
  // which the lobe was chosen would end the one and keep the other.
  Scene scene = lit_floor();
  scene.materials[0] = {.name = "lacquer",
                        .kd = Vector3d::Constant(0.5),
                        .bsdf = BsdfKind::coated,
                        .roughness = 0.1};
  const CameraModel model = camera({300, 0, 60}, {40, 30, 0}, 1.0, 16);
  PathOptions without;
  without.sure_bounces = 1000;
  const Mean truth = render(scene, model, without, 1024);
  const Mean mean = render(scene, model, options(), 1024);
  EXPECT_LE(std::hypot(mean.error, truth.error), 4e-3 * truth.value);
  EXPECT_NEAR(mean.value, truth.value, kMostDeviations * std::hypot(mean.error, truth.error));
}

}  // namespace
}  // namespace haarlight::render
