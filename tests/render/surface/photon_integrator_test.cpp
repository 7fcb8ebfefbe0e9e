// SPDX-License-Identifier: Apache-2.0
/// @file
/// Photon mapping beside path tracing and closed forms. It is biased: each test says how much of that it
/// allows, and from where.

#include "render/surface/photon_integrator.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <numbers>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "render/surface/path_integrator.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr int kSize = 16;

CameraModel camera(const Vector3d& eye, const Vector3d& target, double fov_deg) {
  const double focal_px = 0.5 * kSize / std::tan(0.5 * fov_deg * pi / 180.0);
  return testing::square_camera(eye, target, focal_px, kSize);
}

struct Picture {
  Image<float> picture;
  Image<float> error;
  double mean = 0.0;  ///< of all colours
  double mean_error = 0.0;
};
Picture render(const TileRenderer& integrator, std::uint32_t samples) {
  Film film(kSize, kSize, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  Picture made{.picture = film.mean(0), .error = film.standard_error(0)};
  const auto n = static_cast<double>(made.picture.pixels().size());
  double squares = 0.0;
  for (std::size_t i = 0; i < made.picture.pixels().size(); ++i) {
    const double value = made.picture.pixels()[i];
    EXPECT_TRUE(std::isfinite(value) && value >= 0.0);
    made.mean += value / n;
    squares += std::pow(double{made.error.pixels()[i]} / n, 2);
  }
  // The colours of a pixel are one sample: as if they were the same.
  made.mean_error = std::sqrt(3.0 * squares);
  return made;
}

Picture photon_map(const Scene& scene, const CameraModel& model, std::uint32_t samples,
                   const PhotonMapOptions& options, const Environment* environment = nullptr) {
  const RayCaster caster(scene);
  return render(PhotonMapIntegrator(scene, caster, environment, model, options), samples);
}

Picture path(const Scene& scene, const CameraModel& model, std::uint32_t samples) {
  const RayCaster caster(scene);
  return render(PathIntegrator(scene, caster, nullptr, model, {.seed = 9}), samples);
}

int add(Scene& scene, Material material) {
  scene.materials.push_back(std::move(material));
  return static_cast<int>(scene.materials.size()) - 1;
}

void turn_inside_out(Mesh& mesh) {
  for (Eigen::Vector3i& triangle : mesh.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  for (Vector3d& normal : mesh.normals) {
    normal = -normal;
  }
}

/// Within a sphere that emits and reflects everywhere: L/(1 - albedo), with and without a final gather,
/// its normals those of the sphere or of the triangles. The standard error of the photons is
/// sqrt(albedo)/(1 - albedo)/sqrt(40000) of the emitted light or less, 0.4 % of the whole; and
/// the disks are cut where facets meet. 1.5 % are allowed.
TEST(PhotonMapping, AFurnaceShowsTheSameEverywhere) {
  constexpr double kEmitted = 2.0;
  constexpr double kHalf = 0.5;
  for (const bool is_smooth : {true, false}) {
    Scene scene;
    const int wall = add(scene, {.name = "wall",
                                 .kd = Vector3d::Constant(kHalf),
                                 .emits = Vector3d::Constant(kEmitted)});
    Mesh sphere = make_sphere({0, 0, 0}, 100.0, 4, wall);
    if (!is_smooth) {
      sphere.normals.clear();
    }
    turn_inside_out(sphere);
    scene.meshes = {sphere};
    const CameraModel model = camera({10, 20, 30}, {50, -20, -10}, 80.0);
    for (const bool gathers : {true, false}) {
      const Picture picture = photon_map(
          scene, model, 8,
          {.photons = {.photons = 40'000}, .most_bounces = 100, .has_final_gather = gathers});
      const double truth = kEmitted / (1.0 - kHalf);
      std::printf("%s, %s: %.4f\n", is_smooth ? "smooth" : "facets",
                  gathers ? "gather" : "maps", picture.mean / truth);
      EXPECT_NEAR(picture.mean, truth, 0.015 * truth);
    }
  }
}

/// A room with a lamp and a block, which is open to the camera.
Scene room() {
  Scene scene;
  const int white = add(scene, {.name = "white", .kd = Vector3d(0.7, 0.6, 0.5)});
  const int lamp =
      add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(30.0, 24.0, 18.0)});
  Mesh walls = make_box({-150, -150, 0}, {150, 150, 300}, white);
  turn_inside_out(walls);
  scene.meshes = {
      walls, make_box({-80, -20, 0}, {0, 60, 110}, white),
      make_quad({-40, -40, 299}, {-40, 40, 299}, {40, 40, 299}, {40, -40, 299}, lamp)};
  return scene;
}

/// Disks of r mm about points of surfaces are cut at 9400 mm of edges on 590 000 mm^2: by
/// Epanechnikov's kernel 0.17 r of the width beside them is missing. With 20 of some 230 000 photons
/// r is 4 mm, which is 1.1 % of the light of a map: with a final gather half of that, as half of all
/// light has arrived by more than one bounce. 1 % is allowed beside 4 standard errors, without the
/// gather 3 %.
TEST(PhotonMapping, IsPathTracingButForTheBlur) {
  const Scene scene = room();
  const CameraModel model = camera({20, -140, 150}, {0, 50, 100}, 75.0);
  const Picture truth = path(scene, model, 1024);
  for (const bool gathers : {true, false}) {
    const Picture picture = photon_map(
        scene, model, 32, {.photons = {.photons = 100'000}, .has_final_gather = gathers});
    const double error = std::hypot(picture.mean_error, truth.mean_error);
    std::printf("%s: %.5f of %.5f, a standard error of %.5f\n", gathers ? "gather" : "maps",
                picture.mean, truth.mean, error);
    EXPECT_LE(error, 0.003 * truth.mean) << "weak: it would see no error of 2 %";
    EXPECT_NEAR(picture.mean, truth.mean, (gathers ? 0.01 : 0.03) * truth.mean + 4.0 * error);
  }
}

/// The light of a large lamp, by way of a ball of glass or of a mirror, on a matte floor. The picture shows
/// the whole of the caustic, so that a blur moves none out: 1 % of the mean is allowed beside 4
/// standard errors (path tracing finds the lamp by way of the ball by chance).
TEST(PhotonMapping, CausticsAreThoseOfPathTracing) {
  for (const BsdfKind kind : {BsdfKind::dielectric, BsdfKind::mirror}) {
    Scene scene;
    const int matte = add(scene, {.name = "matte", .kd = Vector3d::Constant(0.5)});
    const int lamp =
        add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(8.0)});
    const int ball = add(scene, {.name = "ball", .bsdf = kind});
    scene.meshes = {
        make_quad({-200, -200, 0}, {200, -200, 0}, {200, 200, 0}, {-200, 200, 0}, matte)};
    scene.disks = {{.centre = {60, 0, 300},
                    .normal = Vector3d(-0.2, 0, -1).normalized(),
                    .radius_mm = 150,
                    .material = lamp}};
    scene.spheres = {{.centre = {0, 0, 60}, .radius_mm = 50, .material = ball}};
    const CameraModel model = camera({0, -280, 200}, {-20, 0, 10}, 60.0);
    const Picture truth = path(scene, model, 4096);
    for (const bool gathers : {true, false}) {
      const Picture picture = photon_map(
          scene, model, 32, {.photons = {.photons = 150'000}, .has_final_gather = gathers});
      const double error = std::hypot(picture.mean_error, truth.mean_error);
      std::printf("%s, %s: %.5f of %.5f, a standard error of %.5f\n",
                  std::string(to_string(kind)).c_str(), gathers ? "gather" : "maps",
                  picture.mean, truth.mean, error);
      EXPECT_LE(error, 0.015 * truth.mean) << "weak: it would see no error of 7 %";
      EXPECT_NEAR(picture.mean, truth.mean, 0.01 * truth.mean + 4.0 * error);
    }
  }
}

/// A lamp that shines at a mirror above lights the floor by it alone: a caustic, which gather rays that
/// meet the lamp by way of the mirror, too, must not count again. Some 4000 photons fall on what is seen:
/// 1.6 %, and 0.5 % of the paths; 7 % are allowed.
TEST(PhotonMapping, LightByAMirrorCountsOnce) {
  Scene scene;
  const int matte = add(scene, {.name = "matte", .kd = Vector3d::Constant(0.3)});
  const int lamp =
      add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(8.0)});
  const int mirror = add(scene, {.name = "mirror", .bsdf = BsdfKind::mirror});
  scene.meshes = {
      make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, matte),
      make_quad({-300, -300, 200}, {-300, 300, 200}, {300, 300, 200}, {300, -300, 200},
                mirror)};
  scene.disks = {
      {.centre = {0, 0, 100}, .normal = {0, 0, 1}, .radius_mm = 40, .material = lamp}};
  const CameraModel model = camera({170, -60, 90}, {125, 0, 0}, 30.0);
  const Picture truth = path(scene, model, 4096);
  const Picture gathered =
      photon_map(scene, model, 16, {.photons = {.photons = 200'000}, .has_final_gather = true});
  std::printf("%.5f of %.5f, standard errors of %.5f and %.5f\n", gathered.mean, truth.mean,
              gathered.mean_error, truth.mean_error);
  EXPECT_LE(truth.mean_error, 0.01 * truth.mean);
  EXPECT_NEAR(gathered.mean, truth.mean, 0.07 * truth.mean);
}

/// An even sky over a floor that reflects the fraction kd of it: kd L; the photons come from all sides.
TEST(PhotonMapping, AnEvenSky) {
  Image<float> sky(4, 8, 3);
  std::ranges::fill(sky.pixels(), 1.0F);
  const Environment environment = Environment::from_picture(sky, "even");
  Scene scene;
  const int matte = add(scene, {.name = "matte", .kd = Vector3d::Constant(0.5)});
  scene.meshes = {
      make_quad({-100, -100, 0}, {100, -100, 0}, {100, 100, 0}, {-100, 100, 0}, matte)};
  scene.environment = EnvironmentSource{};
  const CameraModel model = camera({0, -30, 120}, {0, 0, 0}, 50.0);
  for (const bool gathers : {true, false}) {
    const Picture picture = photon_map(
        scene, model, 64, {.photons = {.photons = 200'000}, .has_final_gather = gathers},
        &environment);
    // Without a gather: evenly spread photons are up to 1/(2 k) too few, 1 %; and the noise of some
    // 10 000 that the picture shows.
    EXPECT_NEAR(picture.mean, 0.5, (gathers ? 0.002 : 0.03) * 0.5) << gathers;
  }
}

/// Materials that are no Lambertian ones, under a lamp: what the direct map shows is the direct light of
/// path tracing, within 2 % for the photons' noise.
TEST(PhotonMapping, GlossySurfaces) {
  const std::vector<Material> materials = {
      {.name = "phong", .kd = Vector3d::Constant(0.3), .ks = 0.3, .exponent = 8.0},
      {.name = "rough",
       .kd = Vector3d::Constant(0.6),
       .bsdf = BsdfKind::oren_nayar,
       .sigma = 0.5},
      {.name = "metal",
       .bsdf = BsdfKind::conductor,
       .roughness = 0.5,
       .eta = Vector3d::Constant(0.2),
       .k = Vector3d::Constant(3.0)},
      {.name = "lacquer",
       .kd = Vector3d::Constant(0.4),
       .bsdf = BsdfKind::coated,
       .roughness = 0.4}};
  for (const Material& material : materials) {
    Scene scene;
    const int surface = add(scene, material);
    const int lamp =
        add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(10.0)});
    scene.meshes = {
        make_quad({-300, -300, 0}, {300, -300, 0}, {300, 300, 0}, {-300, 300, 0}, surface),
        make_quad({-80, -30, 150}, {-80, 130, 150}, {80, 130, 150}, {80, -30, 150}, lamp)};
    const CameraModel model = camera({0, -200, 120}, {0, 0, 0}, 25.0);
    const Picture truth = path(scene, model, 256);
    for (const bool gathers : {true, false}) {
      const Picture picture = photon_map(
          scene, model, 16, {.photons = {.photons = 60'000}, .has_final_gather = gathers});
      const double error = std::hypot(picture.mean_error, truth.mean_error);
      std::printf("%s, %s: %.5f of %.5f, a standard error of %.5f\n", material.name.c_str(),
                  gathers ? "gather" : "maps", picture.mean, truth.mean, error);
      EXPECT_NEAR(picture.mean, truth.mean,
                  (gathers ? 0.003 : 0.02) * truth.mean + 4.0 * error);
    }
  }
}

TEST(PhotonMapping, TheSameForAnyThreadsAndPasses) {
  Scene scene = room();
  const int glass = add(scene, {.name = "glass", .bsdf = BsdfKind::dielectric});
  scene.spheres = {{.centre = {80, 0, 60}, .radius_mm = 50, .material = glass}};
  const CameraModel model = camera({20, -140, 150}, {0, 50, 100}, 75.0);
  for (const bool gathers : {true, false}) {
    const PhotonMapOptions options{.photons = {.photons = 5000, .nearest = 20},
                                   .has_final_gather = gathers};
    const Picture whole = photon_map(scene, model, 3, options);
    for (const int threads : {1, 2, 7}) {
      const ThreadLimit limit(threads);
      const Picture again = photon_map(scene, model, 3, options);
      EXPECT_TRUE(std::ranges::equal(again.picture.pixels(), whole.picture.pixels()));
      EXPECT_TRUE(std::ranges::equal(again.error.pixels(), whole.error.pixels()));
    }
    const RayCaster caster(scene);
    const PhotonMapIntegrator integrator(scene, caster, nullptr, model, options);
    FilmTile piece({.x0 = 3, .y0 = 2, .x1 = 13, .y1 = 11}, surface_layers(false));
    for (std::uint32_t sample = 0; sample < 3; ++sample) {
      integrator.render_tile({.first = sample, .end = sample + 1}, piece);
    }
    std::size_t i = 0;
    for (int y = 2; y < 11; ++y) {
      for (int x = 3; x < 13; ++x, i += 6) {
        ASSERT_EQ(static_cast<float>(piece.sums()[i] / 3.0), whole.picture(y, x));
      }
    }
  }
}

/// Scenes times 10^±6, lamps times 10^±20 (as a power of two, which rounds nothing): themselves
/// scaled. A ray that meets an edge in single precision may go another way, and a photon of it: 1 %
/// of the mean.
TEST(PhotonMapping, APictureScalesWithItsScene) {
  const auto scaled_room = [](double scale, double radiance) {
    Scene scene = room();
    for (Mesh& mesh : scene.meshes) {
      for (Vector3d& vertex : mesh.vertices) {
        vertex *= scale;
      }
    }
    scene.materials[1].emits *= radiance;
    return scene;
  };
  for (const bool gathers : {true, false}) {
    const PhotonMapOptions options{.photons = {.photons = 20'000}, .has_final_gather = gathers};
    const auto mean = [&](double scale, double radiance) {
      const CameraModel model =
          camera(scale * Vector3d(20, -140, 150), scale * Vector3d(0, 50, 100), 75.0);
      return photon_map(scaled_room(scale, radiance), model, 4, options).mean;
    };
    const double one = mean(1.0, 1.0);
    EXPECT_GT(one, 0.1);
    for (const double factor : {0x1p-66, 0x1p66}) {
      EXPECT_NEAR(mean(1.0, factor) / factor, one, 1e-6 * one) << factor;
    }
    for (const double scale : {1e-6, 1e6}) {
      EXPECT_NEAR(mean(scale, 1.0), one, 0.01 * one) << scale;
      EXPECT_NEAR(mean(scale, 1e20) / 1e20, one, 0.01 * one) << scale;
    }
  }
}

/// Without photons a final gather is direct light.
TEST(PhotonMapping, WithoutPhotonsOrSurfacesOrLight) {
  Scene scene = room();
  const CameraModel model = camera({20, -140, 150}, {0, 50, 100}, 75.0);
  const RayCaster caster(scene);
  PathOptions direct;
  direct.most_bounces = 1;
  const Picture truth = render(PathIntegrator(scene, caster, nullptr, model, direct), 256);
  const Picture picture =
      photon_map(scene, model, 256, {.photons = {.photons = 0}, .has_final_gather = true});
  EXPECT_NEAR(picture.mean, truth.mean, 4.0 * std::hypot(picture.mean_error, truth.mean_error));
  EXPECT_LE(truth.mean_error, 0.005 * truth.mean);
  scene.materials[1].emits = Vector3d::Zero();
  EXPECT_EQ(photon_map(scene, model, 1, {.photons = {.photons = 100}}).mean, 0.0);
  EXPECT_EQ(photon_map(Scene{}, model, 1, {.photons = {.photons = 100}}).mean, 0.0);
}

}  // namespace
}  // namespace haarlight::render
