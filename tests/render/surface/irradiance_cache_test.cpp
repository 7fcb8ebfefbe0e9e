// SPDX-License-Identifier: Apache-2.0
/// @file
/// Irradiance caching: where the irradiance is known, where it is path tracing, and what its
/// approximations must not do.

#include "render/surface/irradiance_cache.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "render/surface/surface_layers.h"
#include "tests/render/surface/square_camera.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

int add(Scene& scene, Material material) {
  scene.materials.push_back(std::move(material));
  return static_cast<int>(scene.materials.size()) - 1;
}

Mesh turned_inside_out(Mesh mesh) {
  for (Eigen::Vector3i& triangle : mesh.triangles) {
    std::swap(triangle[1], triangle[2]);
  }
  return mesh;
}

struct Picture {
  Image<float> mean;
  Image<float> error;
};
Picture render(const TileRenderer& integrator, int width, int height, std::uint32_t samples) {
  Film film(width, height, surface_layers(false));
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return {film.mean(0), film.standard_error(0)};
}

std::vector<float> values_of(const Picture& picture) {
  return {picture.mean.pixels().begin(), picture.mean.pixels().end()};
}

/// Over all pixels and colours, with the standard error of its noise.
struct Mean {
  double value = 0.0;
  double error = 0.0;
};
Mean mean_of(const Picture& picture) {
  Mean mean;
  const auto n = static_cast<double>(picture.mean.pixels().size());
  for (std::size_t i = 0; i < picture.mean.pixels().size(); ++i) {
    mean.value += double{picture.mean.pixels()[i]} / n;
    mean.error += std::pow(double{picture.error.pixels()[i]} / n, 2);
  }
  mean.error = std::sqrt(mean.error);
  return mean;
}

/// A closed box that looks inwards and emits everywhere: in it the light of k bounces is
/// L_e (1 - rho^(k + 1))/(1 - rho), and the irradiance that is not direct pi L_e (rho + ... + rho^(k - 1)).
/// Where directions alone are followed nothing is left to chance: to the rounding of floats.
TEST(IrradianceCache, AFurnaceShowsTheSameInAllDirections) {
  constexpr double kEmitted = 2.0;
  for (const double rho : {0.0, 0.5, 0.9}) {
    for (const int bounces : {0, 1, 2, 5, 20}) {
      Scene scene;
      const int wall = add(scene, {.name = "wall",
                                   .kd = Vector3d::Constant(rho),
                                   .emits = Vector3d::Constant(kEmitted)});
      scene.meshes.push_back(
          turned_inside_out(make_box({-300, -200, -100}, {300, 250, 150}, wall)));
      const RayCaster caster(scene);
      PathOptions path;
      path.most_bounces = bounces;
      path.sure_bounces = bounces;
      path.sampling = DirectSampling::bsdf;
      const CameraModel model = testing::square_camera({0, 10, 20}, {90, 30, -20}, 12.0, 12);
      const IrradianceCacheIntegrator integrator(scene, caster, nullptr, model, path,
                                                 {.accuracy = 0.5, .gather_rays = 32});
      const double all = kEmitted * (1.0 - std::pow(rho, bounces + 1)) / (1.0 - rho);
      for (const float value : values_of(render(integrator, 12, 12, 4))) {
        ASSERT_NEAR(value, all, 1e-6 * all) << rho << ", " << bounces;
      }
      EXPECT_EQ(integrator.cache().records().empty(), rho == 0.0 || bounces == 0);
      const double indirect =
          pi * std::max(0.0, all - kEmitted * (1.0 + (bounces > 0 ? rho : 0.0))) /
          std::max(rho, 1e-300);
      for (const IrradianceRecord& record : integrator.cache().records()) {
        ASSERT_NEAR(record.irradiance.x(), indirect, 1e-12 * all);
      }
    }
  }
}

/// A plate that a directional light lights evenly, and a floor that this light passes: what the floor
/// receives of the plate, B F in closed form (Lambert's contour formula), and by differences of that
/// what its gradients are. The plate reflects once.
struct Plates {
  Scene scene;
  std::array<Vector3d, 4> corners;
  double radiance = 0.0;
};
Plates plates(bool is_parallel) {
  constexpr double kReflects = 0.8;
  Plates made;
  Scene& scene = made.scene;
  const int floor = add(scene, {.name = "floor", .kd = Vector3d::Constant(0.5)});
  const int plate = add(scene, {.name = "plate", .kd = Vector3d::Constant(kReflects)});
  scene.meshes.push_back(
      make_quad({-40, -40, 0}, {40, -40, 0}, {40, 40, 0}, {-40, 40, 0}, floor));
  made.corners = is_parallel
                     ? std::array<Vector3d, 4>{Vector3d(-50, -60, 120), Vector3d(-50, 60, 120),
                                               Vector3d(70, 60, 120), Vector3d(70, -60, 120)}
                     : std::array<Vector3d, 4>{Vector3d(-60, 60, 10), Vector3d(60, 60, 10),
                                               Vector3d(60, 60, 130), Vector3d(-60, 60, 130)};
  const auto& c = made.corners;
  scene.meshes.push_back(make_quad(c[0], c[1], c[2], c[3], plate));
  // From below, past the floor; or along it.
  const Vector3d direction =
      is_parallel ? Vector3d(-1.0, 0.0, 0.5).normalized() : Vector3d(0.0, 1.0, 0.0);
  scene.directional_lights.push_back(
      {.direction = direction, .irradiance = Vector3d(3.0, 2.0, 1.0)});
  const double cosine = is_parallel ? direction.z() : 1.0;
  made.radiance = kReflects / pi * 3.0 * cosine;
  return made;
}

TEST(IrradianceCache, OfPlatesIsTheClosedForm) {
  for (const bool is_parallel : {true, false}) {
    const Plates made = plates(is_parallel);
    const RayCaster caster(made.scene);
    PathOptions path;
    path.most_bounces = 2;
    const CameraModel model = testing::square_camera({0.3, -1, 90}, {0, 0, 0}, 26.0, 24);
    const IrradianceCacheIntegrator integrator(made.scene, caster, nullptr, model, path,
                                               {.accuracy = 0.2, .gather_rays = 4096});
    const auto truth = [&](const Vector3d& point, const Vector3d& normal) {
      return made.radiance * polygon_irradiance(made.corners, point, normal).value;
    };
    // Each record, its colours apart by the light's; the standard error of their mean from their
    // spread. 4 of them: one in 15 000 honest comparisons is beyond; the seeds are fixed.
    std::vector<double> values;
    double shift_error = 0.0;
    double turn_error = 0.0;
    double shift_truth = 0.0;
    double turn_truth = 0.0;
    for (const IrradianceRecord& record : integrator.cache().records()) {
      const Vector3d& point = record.reach.point;
      const Vector3d& normal = record.reach.normal;
      if (normal.z() < 0.5) {
        continue;  // the plate's own: nothing but the floor is seen from there, and that is dark
      }
      const double known = truth(point, normal);
      values.push_back(record.irradiance.x() / known);
      EXPECT_NEAR(record.irradiance.z(), record.irradiance.x() / 3.0, 1e-12 * known);
      Vector3d by_shift;
      Vector3d by_turn;
      for (int axis = 0; axis < 3; ++axis) {
        const Vector3d step = 0.1 * Vector3d::Unit(axis);
        by_shift[axis] = (truth(point + step, normal) - truth(point - step, normal)) / 0.2;
        const double angle = 1e-3;
        const Vector3d side = Vector3d::Unit(axis).cross(normal);
        by_turn[axis] = (truth(point, (normal + angle * side).normalized()) -
                         truth(point, (normal - angle * side).normalized())) /
                        (2.0 * angle);
      }
      by_shift.z() = 0.0;  // along the normal: not what neighbours on a surface ask for
      shift_error += (record.by_shift.row(0).transpose() - by_shift).squaredNorm();
      shift_truth += by_shift.squaredNorm();
      turn_error += (record.by_turn.row(0).transpose() - by_turn).squaredNorm();
      turn_truth += by_turn.squaredNorm();
    }
    ASSERT_GT(values.size(), 30U);
    const auto n = static_cast<double>(values.size());
    double mean = 0.0;
    double squares = 0.0;
    for (const double value : values) {
      mean += value / n;
    }
    for (const double value : values) {
      squares += (value - mean) * (value - mean);
    }
    const double error = std::sqrt(squares / (n - 1.0) / n);
    std::printf(
        "%zu records, E over the closed form %.5f +- %.5f; gradients off by %.3f, %.3f\n",
        values.size(), mean, error, std::sqrt(shift_error / shift_truth),
        std::sqrt(turn_error / turn_truth));
    EXPECT_LE(error, 1e-3) << "weak: it would see no error of 0.5 %";
    EXPECT_NEAR(mean, 1.0, 4.0 * error);
    // Of 4096 rays some 100 cells are cut by the plate's border, in which its light is all or nothing.
    EXPECT_LE(std::sqrt(shift_error / shift_truth), 0.15);
    EXPECT_LE(std::sqrt(turn_error / turn_truth), 0.05);
  }
}

/// A closed room with a lamp; in it what scatters in every way.
Scene room() {
  Scene scene;
  const int white = add(scene, {.name = "white", .kd = Vector3d::Constant(0.7)});
  const int red = add(scene, {.name = "red",
                              .kd = Vector3d(0.6, 0.2, 0.1),
                              .bsdf = BsdfKind::oren_nayar,
                              .sigma = 0.5});
  const int lamp =
      add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d(9.0, 7.0, 5.0)});
  const int lacquer = add(scene, {.name = "lacquer",
                                  .kd = Vector3d(0.2, 0.5, 0.3),
                                  .bsdf = BsdfKind::coated,
                                  .roughness = 0.2});
  const int metal = add(scene, {.name = "metal",
                                .bsdf = BsdfKind::conductor,
                                .roughness = 0.3,
                                .eta = Vector3d(0.2, 0.9, 1.1),
                                .k = Vector3d(3.9, 2.4, 2.2)});
  const int mirror =
      add(scene,
          {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = Vector3d::Constant(0.9)});
  const int glossy = add(
      scene, {.name = "glossy", .kd = Vector3d::Constant(0.4), .ks = 0.3, .exponent = 20.0});
  scene.meshes.push_back(turned_inside_out(make_box({-200, -200, 0}, {200, 200, 300}, white)));
  scene.meshes.push_back(make_box({-150, -60, 0}, {-60, 60, 120}, red));
  scene.meshes.push_back(make_box({60, 40, 0}, {140, 140, 90}, lacquer));
  scene.meshes.push_back(make_box({60, -120, 0}, {120, -60, 60}, glossy));
  scene.meshes.push_back(
      make_quad({-150, 195, 40}, {150, 195, 40}, {150, 195, 220}, {-150, 195, 220}, mirror));
  scene.spheres.push_back({.centre = {0, -40, 50}, .radius_mm = 45.0, .material = metal});
  scene.meshes.push_back(
      make_quad({-60, -60, 295}, {-60, 60, 295}, {60, 60, 295}, {60, -60, 295}, lamp));
  return scene;
}
CameraModel room_camera(int size) {
  return testing::square_camera({150, -190, 220}, {-30, 40, 60}, 0.75 * size, size);
}

/// Bias of the mean over the picture: at most 1 % here, where the interval of 4 standard errors of the
/// two pictures' noise is added. Records have noise of their own: gather_rays are many.
TEST(IrradianceCache, IsPathTracingInTheMean) {
  const Scene scene = room();
  const RayCaster caster(scene);
  constexpr int kSize = 32;
  PathOptions path;
  path.most_bounces = 12;
  const IrradianceCacheIntegrator cached(scene, caster, nullptr, room_camera(kSize), path,
                                         {.accuracy = 0.25, .gather_rays = 256});
  path.seed = 77;
  const PathIntegrator traced(scene, caster, nullptr, room_camera(kSize), path);
  const Mean a = mean_of(render(cached, kSize, kSize, 32));
  const Mean b = mean_of(render(traced, kSize, kSize, 128));
  const double sigma = std::hypot(a.error, b.error);
  std::printf("%zu records, mean over path tracing's %.4f +- %.4f; leave one out %.3f\n",
              cached.cache().records().size(), a.value / b.value, sigma / b.value,
              cached.leave_one_out());
  EXPECT_LE(sigma, 0.004 * b.value) << "weak: it would see no error of 2 %";
  EXPECT_LE(std::abs(a.value - b.value), 4.0 * sigma + 0.01 * b.value);
  EXPECT_GT(cached.cache().records().size(), 50U);
  EXPECT_GT(cached.cache_rays(), 256U * cached.cache().records().size());
}

/// Of one bounce nothing is indirect; and nothing that is not near-diffuse has a record.
TEST(IrradianceCache, WhereNothingIsCachedItIsPathTracingToTheBit) {
  Scene scene = room();
  const RayCaster caster(scene);
  PathOptions path;
  path.most_bounces = 1;
  const CameraModel model = room_camera(16);
  for (const DirectSampling sampling : {DirectSampling::mis, DirectSampling::light}) {
    path.sampling = sampling;
    const IrradianceCacheIntegrator cached(scene, caster, nullptr, model, path,
                                           {.gather_rays = 4});
    const PathIntegrator traced(scene, caster, nullptr, model, path);
    EXPECT_EQ(values_of(render(cached, 16, 16, 4)), values_of(render(traced, 16, 16, 4)));
    for (const IrradianceRecord& record : cached.cache().records()) {
      EXPECT_TRUE(record.irradiance.isZero(0.0));
    }
  }
  path = {};
  for (Material& material : scene.materials) {
    if (material.emits.isZero(0.0)) {
      material.bsdf =
          material.bsdf == BsdfKind::conductor ? BsdfKind::conductor : BsdfKind::mirror;
      material.reflectance = Vector3d::Constant(0.8);
    }
  }
  const IrradianceCacheIntegrator cached(scene, caster, nullptr, model, path, {});
  EXPECT_TRUE(cached.cache().records().empty());
  EXPECT_EQ(values_of(render(cached, 16, 16, 4)),
            values_of(render(PathIntegrator(scene, caster, nullptr, model, path), 16, 16, 4)));
  const Scene empty;
  const RayCaster nothing(empty);
  const IrradianceCacheIntegrator dark(empty, nothing, nullptr, model, path, {});
  EXPECT_TRUE(dark.cache().records().empty());
  EXPECT_EQ(dark.leave_one_out(), 0.0);
  EXPECT_EQ(mean_of(render(dark, 16, 16, 2)).value, 0.0);
}

TEST(IrradianceCache, TheSameForAnyThreadsPartsAndCrops) {
  const Scene scene = room();
  const RayCaster caster(scene);
  constexpr int kSize = 70;  // tiles of 32 x 32
  const CameraModel model = room_camera(kSize);
  PathOptions path;
  path.most_bounces = 6;
  const IrradianceCacheOptions options{.accuracy = 0.4, .gather_rays = 24};
  const auto make = [&](const PathOptions& its) {
    return std::make_unique<IrradianceCacheIntegrator>(scene, caster, nullptr, model, its,
                                                       options);
  };
  const auto whole = render(*make(path), kSize, kSize, 2);
  const std::vector<float> expected = values_of(whole);
  for (const int n_threads : {1, 2, 7}) {
    const ThreadLimit limit(n_threads);
    EXPECT_EQ(values_of(render(*make(path), kSize, kSize, 2)), expected) << n_threads;
  }
  // Each part by itself, one of them interrupted after its first sample.
  Film joined(kSize, kSize, surface_layers(false));
  for (std::size_t part = 0; part < 2; ++part) {
    Film film(kSize, kSize, surface_layers(false));
    if (part == 1) {
      (void)run(*make(path), {.samples = 1, .part = {.index = part, .n_parts = 2}}, film);
    }
    (void)run(*make(path), {.samples = 2, .part = {.index = part, .n_parts = 2}}, film);
    for (std::size_t tile = part; tile < film.n_tiles(); tile += 2) {
      joined.put(tile, film.take(tile));
    }
  }
  const Image<float> by_parts = joined.mean(0);
  EXPECT_EQ(std::vector<float>(by_parts.pixels().begin(), by_parts.pixels().end()), expected);
  PathOptions of_crop = path;
  of_crop.first_x = 21;
  of_crop.first_y = 9;
  const Picture crop = render(*make(of_crop), 30, 40, 2);
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 30; ++x) {
      for (int c = 0; c < 3; ++c) {
        ASSERT_EQ(crop.mean(y, x, c), whole.mean(y + 9, x + 21, c)) << x << ", " << y;
      }
    }
  }
}

/// A room in two by a wall without thickness, a lamp on one side. The camera sees both from above,
/// where a clipping plane takes the ceiling off. The other side is dark; what leaks there is within
/// a R_min of the wall.
TEST(IrradianceCache, HardlyLeaksThroughAThinWall) {
  for (const double accuracy : {0.2, 0.5, 1.0}) {
    Scene scene;
    const int white = add(scene, {.name = "white", .kd = Vector3d::Constant(0.8)});
    const int lamp =
        add(scene, {.name = "lamp", .kd = Vector3d::Zero(), .emits = Vector3d::Constant(5.0)});
    scene.meshes.push_back(
        turned_inside_out(make_box({-200, -100, 0}, {200, 100, 200}, white)));
    scene.meshes.push_back(
        make_quad({0, -100, 0}, {0, 100, 0}, {0, 100, 200}, {0, -100, 200}, white));
    scene.meshes.push_back(
        make_quad({-140, -50, 190}, {-140, 50, 190}, {-60, 50, 190}, {-60, -50, 190}, lamp));
    const RayCaster caster(scene);
    PathOptions path;
    path.most_bounces = 8;
    const Camera camera(testing::square_camera({0, 0, 900}, {0, 0, 0}, 85.0, 48),
                        {.near_mm = 720.0});
    const IrradianceCacheOptions options{
        .accuracy = accuracy, .gather_rays = 128, .least_radius = 0.02, .most_radius = 1.0};
    const IrradianceCacheIntegrator cached(scene, caster, nullptr, camera, path, options);
    double lit = 0.0;
    double leaked = 0.0;
    double far_leaked = 0.0;
    const double least = accuracy * options.least_radius * caster.scene_radius_mm();
    for (int i = 0; i < 40; ++i) {
      for (int j = 0; j < 8; ++j) {
        const double x = 1.0 + 2.0 * i;
        const double y = -70.0 + 20.0 * j;
        const auto here = cached.cache().irradiance({-x, y, 0}, Vector3d::UnitZ());
        const auto there = cached.cache().irradiance({x, y, 0}, Vector3d::UnitZ());
        lit += here ? here->x() : 0.0;
        leaked += there ? there->x() : 0.0;
        far_leaked += there && x > least ? there->x() : 0.0;
      }
    }
    std::printf("accuracy %.1f: %zu records, leaks %.2g of the light, beyond a R_min %.2g\n",
                accuracy, cached.cache().records().size(), leaked / lit, far_leaked / lit);
    ASSERT_GT(lit, 0.0);
    EXPECT_LE(leaked / lit, 0.02);  // 3 of these 40 distances are within a R_min, at most
    EXPECT_LE(far_leaked / lit, 1e-4);
  }
}

TEST(IrradianceCache, APictureDoesNotDependOnScaleOrLight) {
  const auto scaled = [](double scale, double light) {
    Scene scene = room();
    for (Mesh& mesh : scene.meshes) {
      for (Vector3d& vertex : mesh.vertices) {
        vertex *= scale;
      }
    }
    for (Sphere& sphere : scene.spheres) {
      sphere.centre *= scale;
      sphere.radius_mm *= scale;
    }
    for (Material& material : scene.materials) {
      material.emits *= light;
    }
    CameraModel model = room_camera(24);
    model.world_from_cam.translation() *= scale;
    const RayCaster caster(scene);
    PathOptions path;
    path.most_bounces = 4;
    const IrradianceCacheIntegrator integrator(scene, caster, nullptr, model, path,
                                               {.accuracy = 0.5, .gather_rays = 24});
    for (const IrradianceRecord& record : integrator.cache().records()) {
      EXPECT_TRUE(record.irradiance.allFinite() && record.by_shift.allFinite() &&
                  record.by_turn.allFinite());
    }
    return values_of(render(integrator, 24, 24, 4));
  };
  const std::vector<float> one = scaled(1.0, 1.0);
  for (const auto& [scale, light] : {std::pair{1e-6, 1.0}, std::pair{1e6, 1.0},
                                     std::pair{1.0, 1e-20}, std::pair{1.0, 1e20}}) {
    const std::vector<float> other = scaled(scale, light);
    int n_other = 0;  // rays that meet edges in single precision may meet another triangle
    for (std::size_t i = 0; i < one.size(); ++i) {
      ASSERT_TRUE(std::isfinite(other[i]) && other[i] >= 0.0F);
      const double value = one[i];
      n_other += std::abs(double{other[i]} / light - value) > 1e-3 * value + 1e-6 ? 1 : 0;
    }
    EXPECT_LE(n_other, static_cast<int>(one.size()) / 50) << scale << ", " << light;
  }
}

/// In a wall, in a box, within the lamp's plane.
TEST(IrradianceCache, FromCamerasInPlacesWhereNoneShouldBeIsFinite) {
  const Scene scene = room();
  const RayCaster caster(scene);
  PathOptions path;
  path.most_bounces = 4;
  for (const Vector3d& eye : {Vector3d(200, 0, 100), Vector3d(-100, 0, 60), Vector3d(0, 0, 295),
                              Vector3d(0, -40, 50), Vector3d(200, 200, 300)}) {
    const CameraModel model = testing::square_camera(eye, {-30, 40, 61}, 12.0, 16);
    const IrradianceCacheIntegrator integrator(scene, caster, nullptr, model, path,
                                               {.accuracy = 0.5, .gather_rays = 16});
    for (const float value : values_of(render(integrator, 16, 16, 2))) {
      ASSERT_TRUE(std::isfinite(value) && value >= 0.0F);
    }
  }
}

TEST(IrradianceCache, NeedsNoMoreMemoryThanItMay) {
  const Scene scene = room();
  const RayCaster caster(scene);
  const CameraModel model = room_camera(32);
  try {
    const IrradianceCacheIntegrator integrator(
        scene, caster, nullptr, model, {},
        {.accuracy = 0.05, .gather_rays = 4, .memory_bytes = 20000});
    FAIL() << integrator.cache().bytes();
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("records of irradiance"), std::string::npos);
    EXPECT_NE(error.hint().find("--accuracy"), std::string::npos);
    EXPECT_EQ(error.code(), ExitCode::usage);
  }
}

}  // namespace
}  // namespace haarlight::render
