// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_integrator.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/direct/direct_light.h"
#include "render/surface/surface_layers.h"

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
struct Rendered {
  Image<float> picture;
  Image<float> error;
};
Mean mean_of(const Rendered& rendered) {
  Mean mean;
  const double n = static_cast<double>(rendered.picture.width()) * rendered.picture.height();
  for (int y = 0; y < rendered.picture.height(); ++y) {
    for (int x = 0; x < rendered.picture.width(); ++x) {
      mean.value += rendered.picture(y, x) / n;
      mean.error += rendered.error(y, x) / n * (rendered.error(y, x) / n);
    }
  }
  mean.error = std::sqrt(mean.error);
  return mean;
}

/// For a picture without features.
class PictureFilm : public Film {
 public:
  PictureFilm(int width, int height) : Film(width, height, surface_layers(false)) {}
};

Rendered render(const Scene& scene, const CameraModel& model, const PathOptions& options,
                std::uint32_t samples) {
  const RayCaster caster(scene);
  const PathIntegrator integrator(scene, caster, nullptr, model, options);
  PictureFilm film(model.width, model.height);
  EXPECT_EQ(run(integrator, {.samples = samples}, film).samples, samples);
  return {.picture = film.mean(0), .error = film.standard_error(0)};
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
      const Mean mean =
          mean_of(render(furnace(albedo), camera({10, 5, 0}, {50, 90, 20}, 70.0, 32), options,
                         albedo == 0.9 ? 256 : 64));
      const double truth = 2.0 / (1.0 - albedo);
      EXPECT_LE(mean.error, 2e-3 * truth) << "weak: it would see no error of 1 %";
      EXPECT_NEAR(mean.value, truth, 4.0 * mean.error + 1e-12)
          << to_string(sampler) << ' ' << albedo;
    }
  }
}

TEST(PathIntegrator, AFurnaceCutAtABounceIsTheGeometricSum) {
  struct Case {
    double albedo;
    int bounces;
    std::uint32_t samples;
  };
  // The last is a case of golden/transport.json; those of many bounces with roulette on the way.
  for (const auto& [albedo, bounces, samples] :
       {Case{0.8, 0, 64}, Case{0.8, 1, 64}, Case{0.8, 2, 64}, Case{0.8, 5, 64},
        Case{0.95, 20, 64}, Case{0.99, 20, 64}, Case{0.99, 100, 128}}) {
    PathOptions options;
    options.most_bounces = bounces;
    options.sure_bounces = bounces <= 5 ? 100 : 4;
    const Mean mean = mean_of(
        render(furnace(albedo), camera({10, 5, 0}, {50, 90, 20}, 70.0, 32), options, samples));
    const double truth = 2.0 * (1.0 - std::pow(albedo, bounces + 1)) / (1.0 - albedo);
    EXPECT_LE(mean.error, 2e-3 * truth) << albedo << ' ' << bounces;
    EXPECT_NEAR(mean.value, truth, 4.0 * mean.error + 1e-6) << albedo << ' ' << bounces;
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
      render(lit.scene, camera({0, 0, 600}, {0, 0, 300}, 5.0, 4), options, 4).picture;
  const Image<float> below =
      render(lit.scene, camera({0, 0, 100}, {0, 0, 300}, 5.0, 4), options, 4).picture;
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
    const Image<float> found = render(lit.scene, model, options, samples).picture;
    options.seed = 99;
    options.sampler = SamplerKind::sobol;
    const Image<float> truth = render(lit.scene, model, options, 4096).picture;
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
  const PathIntegrator integrator(scene, caster, nullptr, model, {});
  PictureFilm whole(model.width, model.height);
  (void)run(integrator, {.samples = 7}, whole);
  for (const int threads : {1, 2, 7}) {
    const ThreadLimit limit(threads);
    PictureFilm film(model.width, model.height);
    (void)run(integrator, {.samples = 7}, film);
    EXPECT_TRUE(std::ranges::equal(film.mean(0).pixels(), whole.mean(0).pixels()));
    EXPECT_TRUE(
        std::ranges::equal(film.standard_error(0).pixels(), whole.standard_error(0).pixels()));
  }
  // A tile of another shape, samples one by one.
  FilmTile piece({.x0 = 9, .y0 = 20, .x1 = 41, .y1 = 50}, surface_layers(false));
  for (std::uint32_t sample = 0; sample < 7; ++sample) {
    integrator.render_tile({.first = sample, .end = sample + 1}, piece);
  }
  const Image<float> picture = whole.mean(0);
  std::size_t i = 0;
  for (int y = 20; y < 50; ++y) {
    for (int x = 9; x < 41; ++x, i += 6) {
      ASSERT_EQ(static_cast<float>(piece.sums()[i] / 7.0), picture(y, x)) << x << ' ' << y;
    }
  }
}

TEST(PathIntegrator, AnEdgeOutOfFocusIsBlurredByTheAperture) {
  // A half-plane emits at twice the distance in focus: a picture point u pixels off its edge sees
  // the part of the aperture beyond q = u z/(f (z/z_f - 1)), a segment of a disk.
  Scene scene;
  scene.materials = {{.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d::Ones()}};
  scene.meshes.push_back(
      make_quad({0, -4e3, 800}, {0, 4e3, 800}, {4e3, 4e3, 800}, {4e3, -4e3, 800}, 0));
  CameraModel model;
  model.width = 24;
  model.height = 16;
  model.fx = 200.0;
  model.fy = 200.0;
  model.cx = 12.0;
  model.cy = 8.0;  // looks along z, x to the right
  constexpr double kRadius = 20.0;
  constexpr double kPerPixel = 800.0 / (200.0 * (800.0 / 400.0 - 1.0));  // q of a pixel, mm
  const RayCaster caster(scene);
  for (const FilterKind filter :
       {FilterKind::box, FilterKind::gaussian, FilterKind::mitchell}) {
    PathOptions options;
    options.filter = filter;
    const PathIntegrator integrator(scene, caster, nullptr,
                                    {model, {.lens_radius_mm = kRadius, .focus_mm = 400.0}},
                                    options);
    PictureFilm film(model.width, model.height);
    (void)run(integrator, {.samples = 4096}, film);
    const Image<float> picture = film.mean(0);
    const auto beyond = [&](double u) {  // the aperture's part with q < t
      const double t = std::clamp(u * kPerPixel / kRadius, -1.0, 1.0);
      return 0.5 + (t * std::sqrt(1.0 - t * t) + std::asin(t)) / pi;
    };
    int n_blurred = 0;
    for (int x = 0; x < model.width; ++x) {
      double truth = 0.0;
      double norm = 0.0;
      constexpr int kN = 4000;
      for (int i = 0; i < kN; ++i) {
        const double at = -2.0 + 4.0 * (i + 0.5) / kN;
        truth += filter_value(filter, at) * beyond(x + 0.5 + at - model.cx);
        norm += filter_value(filter, at);
      }
      truth /= norm;
      double mean = 0.0;
      for (int y = 0; y < model.height; ++y) {
        mean += static_cast<double>(picture(y, x)) / model.height;
      }
      // Of 65 536 samples the standard error is at most 0.002 (0.003 with Mitchell's weights, which
      // are negative at times), were they independent.
      EXPECT_NEAR(mean, truth, 0.004) << to_string(filter) << ' ' << x;
      n_blurred += truth > 0.01 && truth < 0.99 ? 1 : 0;
    }
    EXPECT_GE(n_blurred, 7) << "the edge is blurred over 2 x 20 / 4 = 10 pixels";
  }
}

TEST(PathIntegrator, FeaturesAreThoseOfTheSurfaceThatIsSeen) {
  // A camera that looks down at a floor, a quarter of which is left out.
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d(0.2, 0.4, 0.95), .ks = 0.1},
                     {.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d::Ones()}};
  scene.meshes.push_back(
      make_quad({-900, 0, 0}, {900, 0, 0}, {900, 900, 0}, {-900, 900, 0}, 0));
  scene.meshes.push_back(
      make_quad({-900, 0, 2000}, {-900, 9, 2000}, {900, 9, 2000}, {900, 0, 2000}, 1));
  const RayCaster caster(scene);
  PathOptions options;
  options.has_features = true;
  CameraModel model = camera({0, 0, 500}, {0, 0, 0}, 60.0, 64);
  const PathIntegrator integrator(scene, caster, nullptr, model, options);
  Film film(64, 64, surface_layers(true));
  EXPECT_EQ(run(integrator, {.samples = 8}, film).samples, 8U);
  const Image<float> albedo = film.mean(SurfaceLayer::kAlbedo);
  const Image<float> normal = film.mean(SurfaceLayer::kNormal);
  const Image<float> depth = film.mean(SurfaceLayer::kDepth);
  const Image<float> coverage = film.mean(SurfaceLayer::kCoverage);
  int n_seen = 0;
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const CameraRay ray = ray_through(model, x + 0.5, y + 0.5);
      const double floor_y = ray.origin_world.y() - ray.origin_world.z() *
                                                        ray.direction_world.y() /
                                                        ray.direction_world.z();
      if (std::abs(floor_y) < 30.0) {
        continue;  // a pixel on the edge
      }
      const float seen = floor_y > 0.0 ? 1.0F : 0.0F;
      n_seen += floor_y > 0.0 ? 1 : 0;
      EXPECT_EQ(coverage(y, x), seen);
      EXPECT_FLOAT_EQ(albedo(y, x, 0), 0.3F * seen);
      EXPECT_FLOAT_EQ(albedo(y, x, 2), seen) << "at most 1";
      EXPECT_FLOAT_EQ(normal(y, x, 2), seen);
      EXPECT_NEAR(depth(y, x), 500.0F * seen, 1e-3) << "along the axis, not along the ray";
    }
  }
  EXPECT_GT(n_seen, 1000);
}

TEST(PathIntegrator, NoLightIsLostFromALampAsNearAsTheRaysOffset) {
  // On a floor so large that rays start 0.22 mm off it, a lamp of 0.88 mm stands 0.33 mm away: part
  // of it is nearer than light points are drawn.
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(0.6)},
                     {.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d::Ones()}};
  const double d = 0x1p17 / std::sqrt(2.0);
  scene.meshes.push_back(make_quad({-d, -d, 0}, {d, -d, 0}, {d, d, 0}, {-d, d, 0}, 0));
  // Its front looks along -y.
  constexpr double kOffset =
      0.21875;  // 14 roundings of 2^18 mm, the side of the floor's triangles
  scene.meshes.push_back(make_quad({-2 * kOffset, 0, kOffset}, {2 * kOffset, 0, kOffset},
                                   {2 * kOffset, 0, 5 * kOffset},
                                   {-2 * kOffset, 0, 5 * kOffset}, 1));
  const RayCaster caster(scene);
  const Vector3d target(0, -1.5 * kOffset, 0);
  ASSERT_NEAR(caster.offset_mm(0, 0, target), kOffset, 1e-6);
  SquareLight light;
  light.centre = {0, 0, 3.0 * kOffset};
  light.u = Vector3d::UnitX();
  light.v = Vector3d::UnitZ();
  light.emits = -Vector3d::UnitY();
  light.width_mm = 4.0 * kOffset;
  light.height_mm = 4.0 * kOffset;
  PathOptions options;
  options.most_bounces = 1;
  const CameraModel model = camera(target + Vector3d(0, -50, 200), target, 1e-5, 8);
  const Mean mean = mean_of(render(scene, model, options, 8192));
  // Where rays start.
  const double truth =
      0.6 / pi * light_irradiance(light, target + Vector3d(0, 0, kOffset), Vector3d::UnitZ());
  EXPECT_LE(mean.error, 2e-3 * truth);
  EXPECT_NEAR(mean.value, truth, 4.0 * mean.error);
}

TEST(PathIntegrator, ASmallPartOfALargeSceneCastsItsShadow) {
  // A plate of 0.4 mm, 0.05 mm over a table of 20 mm, in a scene of 2 * 10^5 mm.
  Scene scene;
  scene.materials = {{.name = "white", .kd = Vector3d::Constant(0.6)}};
  scene.meshes.push_back(make_quad({-10, -10, 0}, {10, -10, 0}, {10, 10, 0}, {-10, 10, 0}, 0));
  scene.meshes.push_back(
      make_quad({-0.2, -0.2, 0.05}, {0.2, -0.2, 0.05}, {0.2, 0.2, 0.05}, {-0.2, 0.2, 0.05}, 0));
  for (const double side : {-1e5, 1e5}) {
    const Vector3d corner = Vector3d::Constant(side);
    scene.meshes.push_back(make_quad(corner, corner + Vector3d(9, 0, 0),
                                     corner + Vector3d(9, 9, 0), corner + Vector3d(0, 9, 0),
                                     0));
  }
  scene.point_lights.push_back(
      {.position = {100, 0, 100}, .intensity = Vector3d::Constant(1e4)});
  const RayCaster caster(scene);
  EXPECT_GT(caster.ray_offset_mm(), 0.1) << "from there the plate would be below";
  EXPECT_LT(caster.offset_mm(0, 0, {-0.225, 0, 0}), 1e-4);
  PathOptions options;
  options.most_bounces = 1;
  // Its shadow reaches 0.05 mm beyond the plate, which hides the table down to x = -0.2.
  for (const bool is_shadow : {true, false}) {
    const Vector3d target(is_shadow ? -0.225 : -0.3, 0, 0);
    const Mean mean = mean_of(
        render(scene, camera(target + Vector3d(0, 0, 200), target, 1e-5, 4), options, 16));
    const Vector3d way = scene.point_lights[0].position - target;
    const double lit = 0.6 / pi * 1e4 * 100.0 / std::pow(way.norm(), 3);
    // 2^-24 of the picture; the spot that is seen is 4e-5 mm.
    EXPECT_NEAR(mean.value, is_shadow ? 0.0 : lit, 1e-6 * lit);
  }
}

TEST(PathIntegrator, ALampDoesNotHideItselfWhereItIsGrazed) {
  Scene scene;
  scene.materials = {{.name = "floor", .kd = Vector3d::Constant(0.6)},
                     {.name = "light", .kd = Vector3d::Zero(), .emits = Vector3d::Ones()}};
  scene.meshes.push_back(
      make_quad({-2e3, -2e3, 0}, {2e3, -2e3, 0}, {2e3, 2e3, 0}, {-2e3, 2e3, 0}, 0));
  // A wall of no simple position, its front looks along (1, -2, 0).
  const Vector3d u = Vector3d(2, 1, 0).normalized();
  const Vector3d foot(700.123, 333.377, 50.0);
  scene.meshes.push_back(make_quad(foot, foot + 300 * u, foot + 300 * u + Vector3d(0, 0, 300),
                                   foot + Vector3d(0, 0, 300), 1));
  const RayCaster caster(scene);
  SquareLight light;
  light.centre = foot + 150 * u + Vector3d(0, 0, 150);
  light.u = u;
  light.v = Vector3d::UnitZ();
  light.emits = Vector3d(1, -2, 0).normalized();
  light.width_mm = 300.0;
  light.height_mm = 300.0;
  for (const double cosine : {0.1, 0.01, 0.003}) {
    Vector3d target = foot - 500 * u + 800.0 * cosine * light.emits;
    target.z() = 0.0;
    PathOptions options;
    options.most_bounces = 1;
    const CameraModel model = camera(target + Vector3d(0, -50, 200), target, 1e-5, 8);
    const Mean mean = mean_of(render(scene, model, options, 8192));
    const double truth =
        0.6 / pi *
        light_irradiance(light, target + Vector3d(0, 0, caster.offset_mm(0, 0, target)),
                         Vector3d::UnitZ());
    EXPECT_LE(mean.error, 5e-3 * truth);
    EXPECT_NEAR(mean.value, truth, 4.0 * mean.error) << cosine;
  }
}

}  // namespace
}  // namespace haarlight::render
