// SPDX-License-Identifier: Apache-2.0
/// @file
/// Photon maps where the light is known in closed form, and what must never be counted.

#include "render/surface/photon_maps.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "render/bsdf/shading_frame.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;
using std::numbers::pi;

constexpr double kAlbedo = 0.7;

/// What the maps tell of a point of a surface, seen along a ray.
struct Seen {
  Hit hit;
  Eigen::Matrix3d world_from_local;
  Vector3d to_eye;
  Bsdf bsdf;

  [[nodiscard]] PhotonQuery query() const {
    return {.hit = hit, .world_from_local = world_from_local, .to_eye = to_eye, .bsdf = bsdf};
  }
};
Seen seen(const Scene& scene, const RayCaster& caster, const Vector3d& from,
          const Vector3d& to) {
  const Ray ray{.origin = from, .direction = (to - from).normalized()};
  const Hit hit = caster.surface_at(ray, caster.intersect(ray));
  const Eigen::Matrix3d frame = shading_frame(hit, ray.direction);
  return {.hit = hit,
          .world_from_local = frame,
          .to_eye = -(frame.transpose() * ray.direction),
          .bsdf = bsdf_of(scene, hit)};
}

PhotonMaps maps_of(const Scene& scene, const RayCaster& caster, const PhotonOptions& options) {
  const SceneLights lights(scene, nullptr, caster.scene_radius_mm(), LightChoice::all);
  return {scene, caster, lights, options};
}

Scene floor_scene() {
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(kAlbedo)},
                     {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(3, 2, 1)}};
  scene.meshes = {make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, 0)};
  return scene;
}

/// A cone of light that leaves a point downwards, and covers the floor about the middle.
PointLight spot(const Vector3d& position) {
  return {.position = position,
          .intensity = Vector3d(4e4, 3e4, 2e4),
          .cos_full = 0.75,
          .cos_end = 0.7};
}

struct Lit {
  std::string name;
  Scene scene;
  std::uint32_t photons;
  double (*irradiance)(const Vector3d& at);  ///< of red
};

std::vector<Lit> lit_floors() {
  std::vector<Lit> all;
  all.push_back({"a spot", floor_scene(), 12'000, [](const Vector3d& at) {
                   const Vector3d way = Vector3d(0, 0, 400) - at;
                   return 4e4 * way.z() / std::pow(way.norm(), 3);
                 }});
  all.back().scene.point_lights = {spot({0, 0, 400})};
  all.push_back({"a quad", floor_scene(), 30'000, [](const Vector3d& at) {
                   const std::vector<Vector3d> corners = {
                       {-50, -50, 400}, {-50, 50, 400}, {50, 50, 400}, {50, -50, 400}};
                   return 3.0 * polygon_irradiance(corners, at, Vector3d::UnitZ()).value;
                 }});
  all.back().scene.meshes.push_back(
      make_quad({-50, -50, 400}, {-50, 50, 400}, {50, 50, 400}, {50, -50, 400}, 1));
  all.push_back({"a sphere", floor_scene(), 60'000, [](const Vector3d& at) {
                   const Vector3d way = Vector3d(0, 0, 400) - at;
                   return 3.0 * pi * 40.0 * 40.0 * way.z() / std::pow(way.norm(), 3);
                 }});
  all.back().scene.spheres = {{.centre = {0, 0, 400}, .radius_mm = 40, .material = 1}};
  return all;
}

/// Means over 13 x 13 points 20 mm apart, whose disks do not meet, and 16 seeds: Student's t with 15
/// degrees of freedom, |t| <= 4.9 is one false alarm in 100 runs of all of these comparisons (two-sided
/// 2e-4 each). Points are lit by independent rays: of evenly spread ones, k - 1 is up to half a photon
/// too few. The blur itself adds r^2/8 times the Laplacian of the irradiance: with r below 12 mm
/// at 400 mm less than 1e-3 of it.
TEST(PhotonMaps, TheDirectMapIsTheIrradianceOfALamp) {
  constexpr int kReplicates = 16;
  constexpr int kSide = 13;
  for (const Lit& lit : lit_floors()) {
    const RayCaster caster(lit.scene);
    for (const PhotonKernel kernel : {PhotonKernel::constant, PhotonKernel::epanechnikov}) {
      std::vector<double> ratios;
      double largest_radius = 0.0;
      for (std::uint64_t seed = 0; seed < kReplicates; ++seed) {
        const PhotonMaps maps = maps_of(lit.scene, caster,
                                        {.photons = lit.photons,
                                         .nearest = 10,
                                         .kernel = kernel,
                                         .most_bounces = 0,
                                         .sampler = SamplerKind::independent,
                                         .seed = seed});
        double sum = 0.0;
        double truth = 0.0;
        for (int i = 0; i < kSide * kSide; ++i) {
          const Eigen::Vector3i cell(i % kSide - kSide / 2, i / kSide - kSide / 2, 0);
          const Vector3d at = 20.0 * cell.cast<double>();
          const Seen here = seen(lit.scene, caster, at + Vector3d(0, 0, 10), at);
          sum += maps.radiance(PhotonKind::direct, here.query()).x() * pi / kAlbedo;
          truth += lit.irradiance(at);
        }
        ratios.push_back(sum / truth);
        EXPECT_EQ(maps.size(PhotonKind::caustic) + maps.size(PhotonKind::indirect), 0U);
        largest_radius = std::max(
            largest_radius, std::sqrt(10.0 * maps.flux(PhotonKind::direct).x() /
                                      (static_cast<double>(maps.size(PhotonKind::direct)) * pi *
                                       truth / (kSide * kSide))));
      }
      double mean = 0.0;
      for (const double ratio : ratios) {
        mean += ratio / kReplicates;
      }
      double squares = 0.0;
      for (const double ratio : ratios) {
        squares += (ratio - mean) * (ratio - mean);
      }
      const double error = std::sqrt(squares / (kReplicates - 1) / kReplicates);
      std::printf("%s, %s: %.4f, a standard error of %.4f, r %.1f mm\n", lit.name.c_str(),
                  std::string(to_string(kernel)).c_str(), mean, error, largest_radius);
      EXPECT_LE(largest_radius, 12.0);
      EXPECT_LE(error, 0.012) << "weak: it would not see k for k - 1, 11 %";
      EXPECT_NEAR(mean, 1.0, 4.9 * error + 1e-3) << lit.name;
    }
  }
}

/// All photons of one lamp carry alike: k for k - 1.
TEST(PhotonMaps, TheSlidesCountThePhotonThatSetsTheRadius) {
  const Lit lit = std::move(lit_floors().front());
  const RayCaster caster(lit.scene);
  PhotonOptions options{.photons = 5000, .nearest = 10};
  const Seen here = seen(lit.scene, caster, {5, 5, 10}, {5, 5, 0});
  const double own =
      maps_of(lit.scene, caster, options).radiance(PhotonKind::direct, here.query()).x();
  options.kernel = PhotonKernel::slides;
  const double slides =
      maps_of(lit.scene, caster, options).radiance(PhotonKind::direct, here.query()).x();
  EXPECT_NEAR(slides / own, 10.0 / 9.0, 1e-6);
}

/// Light falls by the square of the distance; with evenly spread photons within 1/(2 k) and the
/// unevenness of a few of them.
TEST(PhotonMaps, LightFallsByTheSquareOfTheDistance) {
  double first = 0.0;
  for (const double distance : {100.0, 200.0, 400.0}) {
    Scene scene = floor_scene();
    scene.point_lights = {spot({0, 0, distance})};
    const RayCaster caster(scene);
    const PhotonMaps maps = maps_of(scene, caster, {.photons = 40'000, .nearest = 200});
    const Seen here = seen(scene, caster, {0, 0, 10}, {0, 0, 0});
    const double irradiance =
        maps.radiance(PhotonKind::direct, here.query()).x() * pi / kAlbedo;
    EXPECT_NEAR(irradiance * distance * distance, 4e4, 0.03 * 4e4) << distance;
    first = first == 0.0 ? irradiance : first;
    EXPECT_NEAR(first / irradiance, distance * distance / 1e4,
                0.04 * distance * distance / 1e4);
  }
}

/// Sums of the weights over evenly spread sites, whose density is known. 0.5 %: 400 sites on the border
/// of a disk of 10^4 count or do not.
TEST(PhotonTree, KernelsHaveTheIntegralOne) {
  std::vector<PhotonSite> sites;
  const PixelSamples numbers(SamplerKind::sobol, 1, 0, 0);
  constexpr std::uint32_t kSites = 1 << 16;
  for (std::uint32_t i = 0; i < kSites; ++i) {
    const Eigen::Vector2d at = numbers.two(i, 0);
    sites.push_back({.position = {static_cast<float>(at.x()), static_cast<float>(at.y()), 0}});
  }
  const SiteTree tree(std::move(sites));
  for (const PhotonKernel kernel :
       {PhotonKernel::constant, PhotonKernel::epanechnikov, PhotonKernel::slides}) {
    for (const std::size_t k : {std::size_t{1000}, std::size_t{100'000}}) {
      NearPhotons found;
      std::vector<double> weights;
      tree.nearest({.position = {0.5, 0.5, 0}}, k, 0.25, found);
      EXPECT_EQ(found.has_kth, k == 1000) << "else the largest radius ends the disk";
      weigh(kernel, found, weights);
      double sum = 0.0;
      for (const double weight : weights) {
        sum += weight;
      }
      EXPECT_NEAR(sum, kSites, 5e-3 * kSites) << to_string(kernel);
    }
  }
}

TEST(PhotonTree, TheNearestAreThoseOfAFullSearch) {
  std::vector<PhotonSite> sites;
  const PixelSamples numbers(SamplerKind::independent, 2, 0, 0);
  for (std::uint32_t i = 0; i < 3000; ++i) {
    const Eigen::Vector2d at = numbers.two(i, 0);
    sites.push_back({.position = {static_cast<float>(at.x()), static_cast<float>(at.y()),
                                  static_cast<float>(0.01 * numbers.one(i, 1))},
                     .normal = Vector3f(0, 0, i % 3 == 0 ? -1.0F : 1.0F),
                     .surface = i % 2});
  }
  const SiteTree tree(sites);
  for (std::uint32_t i = 0; i < 50; ++i) {
    const PhotonSite& at = sites[std::size_t{i} * 7];
    for (const std::size_t k : {1U, 2U, 17U, 3000U}) {
      NearPhotons found;
      tree.nearest(at, k, 0.3, found);
      std::vector<float> all;
      for (const PhotonSite& site : sites) {
        const float squared = (site.position - at.position).squaredNorm();
        if (is_on_same_side(site, at) && squared < 0.09F) {
          all.push_back(squared);
        }
      }
      std::ranges::sort(all);
      ASSERT_EQ(found.photons.size(), std::min(k, all.size()));
      ASSERT_EQ(found.has_kth, all.size() >= k);
      float farthest = 0.0F;
      for (const NearPhoton& photon : found.photons) {
        farthest = std::max(farthest, photon.squared_distance);
      }
      EXPECT_NEAR(farthest, all[found.photons.size() - 1], 1e-6F * farthest);
      EXPECT_EQ(found.photons.front().squared_distance, farthest)
          << "the first sets the radius";
    }
  }
}

/// A sheet without thickness, red light above and blue light below: each side shows its own.
TEST(PhotonMaps, AThinWallIsLitOnTheSideOfTheLight) {
  Scene scene = floor_scene();
  scene.point_lights = {{.position = {0, 0, 200},
                         .intensity = Vector3d(1e4, 0, 0),
                         .cos_full = 0.8,
                         .cos_end = 0.8},
                        {.position = {0, 0, -200},
                         .intensity = Vector3d(0, 0, 1e4),
                         .axis = Vector3d::UnitZ(),
                         .cos_full = 0.8,
                         .cos_end = 0.8}};
  const RayCaster caster(scene);
  const PhotonMaps maps = maps_of(scene, caster, {.photons = 20'000});
  for (const double side : {1.0, -1.0}) {
    const Seen here = seen(scene, caster, {7, 3, 10 * side}, {7, 3, 0});
    const Vector3d found = maps.radiance(PhotonKind::direct, here.query());
    EXPECT_GT(side > 0.0 ? found.x() : found.z(), 0.05);
    EXPECT_EQ(side > 0.0 ? found.z() : found.x(), 0.0);
  }
}

/// The same with both sides of a wall of 0.5 mm, and a floor close under a shade: what is behind
/// is dark, although lit photons are nearer than any others.
TEST(PhotonMaps, NoLightPassesAThinWallOrAShade) {
  Scene scene = floor_scene();
  scene.meshes.push_back(make_box({-200, -200, 0.5}, {200, 200, 1.0}, 0));
  scene.point_lights = {{.position = {0, 0, 150}, .intensity = Vector3d::Constant(1e4)}};
  const RayCaster caster(scene);
  const PhotonMaps maps = maps_of(scene, caster, {.photons = 40'000});
  const auto direct = [&](const Vector3d& from, const Vector3d& to) {
    return maps.radiance(PhotonKind::direct, seen(scene, caster, from, to).query()).x();
  };
  EXPECT_GT(direct({7, 3, 10}, {7, 3, 1.0}), 0.05) << "the wall's lit side";
  EXPECT_EQ(direct({7, 3, 0.1}, {7, 3, 0.5}), 0.0) << "its other side";
  EXPECT_EQ(direct({7, 3, 0.4}, {7, 3, 0.0}), 0.0) << "the floor below";
}

/// Light that grazes a wall, and falls on the floor at its foot.
TEST(PhotonMaps, AWallDoesNotTakeTheLightOfTheFloor) {
  Scene scene = floor_scene();
  scene.meshes.push_back(
      make_quad({-300, 300, 0}, {300, 300, 0}, {300, 300, 300}, {-300, 300, 300}, 0));
  scene.directional_lights = {{.irradiance = Vector3d::Ones()}};
  const RayCaster caster(scene);
  const PhotonMaps maps = maps_of(scene, caster, {.photons = 40'000});
  const auto direct = [&](const Vector3d& from, const Vector3d& to) {
    return maps.radiance(PhotonKind::direct, seen(scene, caster, from, to).query()).x();
  };
  EXPECT_EQ(direct({0, 250, 3}, {0, 300, 1}), 0.0);
  EXPECT_NEAR(direct({0, 200, 50}, {0, 220, 0}) * pi / kAlbedo, 1.0, 0.1);
}

TEST(PhotonTree, TheOtherSideOfASheetIsAnotherPlace) {
  const PhotonSite at{.position = {0.1F, 0.2F, 0.3F}};
  PhotonSite photon = at;
  photon.position.x() += 0.01F;
  EXPECT_TRUE(is_on_same_side(photon, at));
  photon.normal = -photon.normal;
  EXPECT_FALSE(is_on_same_side(photon, at));
  photon.normal = Vector3f(0, std::sin(0.7F), std::cos(0.7F));
  EXPECT_TRUE(is_on_same_side(photon, at)) << "40 degrees";
  photon.normal = Vector3f::UnitX();
  EXPECT_FALSE(is_on_same_side(photon, at));
  photon.normal = at.normal;
  photon.position.z() += 0.0008F;
  EXPECT_TRUE(is_on_same_side(photon, at)) << "where the surface is bent";
  photon.surface = 1;
  EXPECT_FALSE(is_on_same_side(photon, at)) << "a sheet above it";
}

/// A closed box that looks inwards.
Scene box_scene(double albedo) {
  Scene scene;
  scene.materials = {{.name = "wall", .kd = Vector3d::Constant(albedo)},
                     {.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.5},
                     {.name = "mirror", .bsdf = BsdfKind::mirror}};
  Mesh box = make_box({-300, -300, -300}, {300, 300, 300}, 0);
  for (Eigen::Vector3i& triangle : box.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  scene.meshes = {box};
  scene.point_lights = {{.position = {150, 40, 20}, .intensity = Vector3d(3e4, 2e4, 1e4)}};
  return scene;
}

/// What is shot arrives, over glass and mirrors or without: once, whatever the refraction.
/// Then the fraction albedo of it arrives again, and so on: albedo/(1 - albedo), within 4
/// standard errors of the number of arrivals.
TEST(PhotonMaps, FluxIsConserved) {
  constexpr double kHalf = 0.5;
  constexpr std::uint32_t kRays = 1 << 15;
  Scene scene = box_scene(kHalf);
  scene.spheres = {{.centre = {-50, 0, 0}, .radius_mm = 120, .material = 1},
                   {.centre = {180, -180, 0}, .radius_mm = 80, .material = 2}};
  const RayCaster caster(scene);
  const PhotonMaps maps = maps_of(scene, caster, {.photons = kRays, .most_bounces = 1000});
  const Vector3d power = 4.0 * pi * Vector3d(3e4, 2e4, 1e4);
  EXPECT_EQ(maps.size(PhotonKind::direct) + maps.size(PhotonKind::caustic), kRays);
  EXPECT_GT(maps.size(PhotonKind::caustic), kRays / 10);
  const Vector3d once = maps.flux(PhotonKind::direct) + maps.flux(PhotonKind::caustic);
  EXPECT_NEAR((once - power).norm(), 0.0, 1e-5 * power.norm());
  const double again = maps.flux(PhotonKind::indirect).x() / power.x();
  EXPECT_NEAR(again, kHalf / (1.0 - kHalf),
              4.0 * std::sqrt(kHalf) / (1.0 - kHalf) / std::sqrt(kRays));
}

TEST(PhotonMaps, NothingArrivesFromNothing) {
  const auto total = [](const Scene& scene, std::uint32_t photons) {
    const RayCaster caster(scene);
    const PhotonMaps maps =
        maps_of(scene, caster, {.photons = photons, .has_irradiance = true});
    return maps.size(PhotonKind::direct) + maps.size(PhotonKind::caustic) +
           maps.size(PhotonKind::indirect);
  };
  Scene scene = floor_scene();
  EXPECT_EQ(total(scene, 100), 0U) << "no light";
  scene.point_lights = {{.position = {0, 0, 100}, .intensity = Vector3d::Zero()}};
  EXPECT_EQ(total(scene, 100), 0U) << "a light without power";
  scene.point_lights = {spot({0, 0, 100})};
  EXPECT_EQ(total(scene, 0), 0U);
  EXPECT_GT(total(scene, 100), 50U);
  scene.meshes.clear();
  EXPECT_EQ(total(scene, 100), 0U) << "no surface";
}

TEST(PhotonMaps, MoreThanTheMemoryIsAnError) {
  const Scene scene = box_scene(0.5);
  const RayCaster caster(scene);
  PhotonOptions options{.photons = 10'000, .most_bytes = 1'000'000};
  try {
    (void)maps_of(scene, caster, options);
    ADD_FAILURE() << "no error";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ExitCode::usage);
    EXPECT_NE(std::string(error.what()).find("10000 rays"), std::string::npos) << error.what();
  }
  options.most_bytes = 100'000'000;
  EXPECT_GT(maps_of(scene, caster, options).size(PhotonKind::indirect), 5000U);
}

}  // namespace
}  // namespace haarlight::render
