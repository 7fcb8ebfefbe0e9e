// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/reproject.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "core/random.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/render/analytic/polygon_light.h"
#include "haarlight/render/direct/picture.h"
#include "relight/shadow/shadow_truth.h"

namespace haarlight::relight {
namespace {

constexpr double kH = 900.0;

render::SquareLight light_at(double x, double y, double z = kH) {
  render::SquareLight light;
  light.centre = {x, y, z};
  light.width_mm = light.height_mm = 28.0;
  return light;
}

PlaneFrame ground_frame() {
  ShadowPlane plane;
  plane.extent_u_mm = plane.extent_v_mm = 400.0;
  plane.texel_mm = 2.0;
  return make_plane_frame(plane);
}

/// A horizontal receiver 300 mm wide at `height`.
render::Scene flat_receiver(double height, double kd = 0.5) {
  render::Scene scene;
  scene.materials.push_back({"white", Eigen::Vector3d::Constant(kd), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-150, -150, height}, {150, -150, height},
                                           {150, 150, height}, {-150, 150, height}, 0));
  return scene;
}

CameraModel camera_from_above() {
  CameraModel camera;
  camera.width = camera.height = 24;
  camera.fx = camera.fy = 60.0;
  camera.cx = camera.cy = 12.0;
  camera.world_from_cam =
      look_at({0.0, -300.0, 500.0}, {0.0, 0.0, 0.0}, Eigen::Vector3d::UnitZ());
  return camera;
}

Visibility uniform_visibility(const PlaneFrame& frame, float value, std::uint8_t known = 1) {
  Visibility v{Image<float>(frame.height, frame.width, 1),
               Image<std::uint8_t>(frame.height, frame.width, 1),
               {}};
  for (float& p : v.value.pixels()) {
    p = value;
  }
  for (std::uint8_t& p : v.known.pixels()) {
    p = known;
  }
  return v;
}

ReprojectOptions plain_options() {
  ReprojectOptions options;
  options.n_subpixels = 1;
  options.has_own_shadows = false;
  return options;
}

double total(const Image<float>& image) {
  double sum = 0.0;
  for (const float v : image.pixels()) {
    sum += static_cast<double>(v);
  }
  return sum;
}

TEST(ReceiverIrradiance, AgreesWithTheExactForm) {
  double worst = 0.0;
  for (std::uint64_t i = 0; i < 4000; ++i) {
    auto draw = [&, k = std::uint64_t{0}]() mutable {
      return 2.0 * uniform_unit(hash_key(5, i, ++k)) - 1.0;
    };
    const render::SquareLight light = light_at(465.0 * draw(), 465.0 * draw());
    const Eigen::Vector3d point(200.0 * draw(), 200.0 * draw(), 300.0 * draw());
    const Eigen::Vector3d normal = Eigen::Vector3d{draw(), draw(), 1.0}.normalized();
    const double exact = render::light_irradiance(light, point, normal);
    const double fast = receiver_irradiance(light, point, normal);
    worst = std::max(worst, std::abs(fast - exact) / std::max(exact, 1e-12));
  }
  RecordProperty("worst_relative", std::to_string(worst));
  EXPECT_LT(worst, 1e-5);
}

TEST(Reproject, WithoutAShadowItIsLambertsLaw) {
  const PlaneFrame frame = ground_frame();
  const std::vector<render::SquareLight> lights{light_at(15.0, 45.0)};
  const std::vector<Eigen::Vector3d> weights{Eigen::Vector3d(1.0, 2.0, 3.0)};
  const render::Scene scene = flat_receiver(-40.0);
  const CameraModel camera = camera_from_above();
  const ReprojectResult result = reproject_shadow(
      scene, camera, frame, lights, weights,
      [&](int) { return uniform_visibility(frame, 1.0F); }, plain_options());
  const render::RayCaster caster(scene);
  const auto seen = render::visible_surface(caster, camera, 12.5, 12.5);
  ASSERT_TRUE(seen);
  const double E = render::light_irradiance(lights[0], seen->point, Eigen::Vector3d::UnitZ());
  EXPECT_NEAR(
      static_cast<double>(result.picture(12, 12, 1)) / (0.5 / std::numbers::pi * 2.0 * E), 1.0,
      1e-5);
  EXPECT_NEAR(result.report.below_fraction, 1.0, 1e-12);
  EXPECT_EQ(result.report.n_lights, 1);
}

TEST(Reproject, BlackEnvironmentAsksForNothing) {
  const PlaneFrame frame = ground_frame();
  const std::vector<render::SquareLight> lights{light_at(0.0, 0.0), light_at(30.0, 0.0)};
  const std::vector<Eigen::Vector3d> weights(2, Eigen::Vector3d::Zero());
  const ReprojectResult result = reproject_shadow(
      flat_receiver(0.0), camera_from_above(), frame, lights, weights,
      [&](int) -> Visibility { throw std::logic_error("nobody may ask"); }, plain_options());
  EXPECT_EQ(total(result.picture), 0.0);
  EXPECT_EQ(result.report.unseen_relative, 0.0);
  EXPECT_EQ(result.report.n_lights, 0);
}

TEST(Reproject, LightInThePlaneIsDrawnLitAndReported) {
  const PlaneFrame frame = ground_frame();
  render::SquareLight light = light_at(-600.0, 0.0, 0.0);
  light.emits = Eigen::Vector3d::UnitX();
  light.u = Eigen::Vector3d::UnitY();
  light.v = Eigen::Vector3d::UnitZ();
  const std::vector<render::SquareLight> lights{light};
  const std::vector<Eigen::Vector3d> weights{Eigen::Vector3d::Ones()};
  render::Scene tilted;
  tilted.materials.push_back({"white", Eigen::Vector3d::Constant(0.5), 0.0, 1.0});
  tilted.meshes.push_back(
      render::make_quad({-150, -150, 0}, {150, -150, 80}, {150, 150, 80}, {-150, 150, 0}, 0));
  const ReprojectResult result = reproject_shadow(
      tilted, camera_from_above(), frame, lights, weights,
      [&](int) { return uniform_visibility(frame, 0.0F); }, plain_options());
  EXPECT_GT(total(result.picture), 0.0);
  EXPECT_DOUBLE_EQ(result.report.no_point_fraction, 1.0);
  EXPECT_DOUBLE_EQ(total(result.picture), total(result.unshadowed));
}

TEST(Reproject, UnknownRegionGivesTheMiddleAndTheSpread) {
  const PlaneFrame frame = ground_frame();
  const std::vector<render::SquareLight> lights{light_at(0.0, 0.0)};
  const std::vector<Eigen::Vector3d> weights{Eigen::Vector3d::Ones()};
  const ReprojectResult result = reproject_shadow(
      flat_receiver(0.0), camera_from_above(), frame, lights, weights,
      [&](int) { return uniform_visibility(frame, 0.0F, 0); }, plain_options());
  EXPECT_NEAR(total(result.picture) / total(result.unshadowed), 0.5, 1e-6);
  EXPECT_NEAR(total(result.unseen) / total(result.unshadowed), 0.5, 1e-6);
  EXPECT_FALSE(result.has_spread);
  EXPECT_EQ(total(result.spread), 0.0);
  EXPECT_DOUBLE_EQ(result.report.unknown_fraction, 1.0);
  EXPECT_DOUBLE_EQ(result.report.affected_receivers, 1.0);
  EXPECT_NEAR(result.report.unseen_relative, 1.0, 1e-6);
  EXPECT_DOUBLE_EQ(result.report.on_fraction, 1.0);
}

TEST(Reproject, ReceiversOverTheObjectAreLit) {
  const PlaneFrame frame = ground_frame();
  const std::vector<render::SquareLight> lights{light_at(0.0, 0.0)};
  const std::vector<Eigen::Vector3d> weights{Eigen::Vector3d::Ones()};
  ReprojectOptions options = plain_options();
  options.object = HeightRange{0.0, 50.0};
  const auto dark = [&](int) { return uniform_visibility(frame, 0.0F); };
  const ReprojectResult over = reproject_shadow(flat_receiver(60.0), camera_from_above(), frame,
                                                lights, weights, dark, options);
  EXPECT_DOUBLE_EQ(total(over.picture), total(over.unshadowed));
  EXPECT_DOUBLE_EQ(over.report.over_object_fraction, 1.0);
  const ReprojectResult among = reproject_shadow(flat_receiver(20.0), camera_from_above(),
                                                 frame, lights, weights, dark, options);
  EXPECT_EQ(total(among.picture), 0.0);
  EXPECT_DOUBLE_EQ(among.report.under_object_fraction, 1.0);
  EXPECT_GT(among.report.worst_widening, 1.0);
}

/// A square plate of 80 mm hovering at 100 mm.
render::Scene hovering_plate() {
  render::Scene scene;
  scene.materials.push_back({"grey", Eigen::Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(
      render::make_quad({-40, -40, 100}, {40, -40, 100}, {40, 40, 100}, {-40, 40, 100}, 0));
  return scene;
}

TEST(Reproject, DoesNotDependOnThreadsOrMemory) {
  const PlaneFrame frame = ground_frame();
  std::vector<render::SquareLight> lights;
  for (int i = 0; i < 5; ++i) {
    lights.push_back(light_at(60.0 * i - 120.0, 40.0));
  }
  const std::vector<Eigen::Vector3d> weights(5, Eigen::Vector3d(1.0, 0.5, 0.25));
  const auto shadow = [&](int k) {
    Visibility v = uniform_visibility(frame, 1.0F);
    for (int x = 60; x < 120; ++x) {
      v.value(90 + k, x) = 0.0F;
    }
    return v;
  };
  // The plate throws a shadow of the scene's own.
  render::Scene scene = flat_receiver(-30.0);
  scene.meshes.push_back(hovering_plate().meshes.front());
  const auto run = [&](int n_threads, std::uint64_t memory) {
    const ThreadLimit limit(n_threads);
    ReprojectOptions options;
    options.n_subpixels = 1;
    options.memory_bytes = memory;
    return reproject_shadow(scene, camera_from_above(), frame, lights, weights, shadow,
                            options);
  };
  const ReprojectResult one = run(1, 1U << 30U);
  const auto equals_one = [&](const ReprojectResult& other) {
    return std::equal(one.picture.pixels().begin(), one.picture.pixels().end(),
                      other.picture.pixels().begin());
  };
  EXPECT_TRUE(equals_one(run(2, 1U << 30U)));
  EXPECT_TRUE(equals_one(run(7, 1U << 30U)));
  EXPECT_TRUE(equals_one(run(2, 1)));  // one light at a time
}

/// The plate's exact shadow picture: a light seen past a parallel rectangle is a product of two
/// shares.
Visibility plate_shadow(const PlaneFrame& frame, const render::SquareLight& light) {
  Visibility v = uniform_visibility(frame, 1.0F);
  const auto hidden = [](double x, double centre) {
    // The ray from x on the plane past y at the plate's height meets the light's height here.
    const auto at = [&](double y) { return x + (y - x) * kH / 100.0; };
    const double low = std::max(at(-40.0), centre - 14.0);
    const double high = std::min(at(40.0), centre + 14.0);
    return std::max(0.0, high - low) / 28.0;
  };
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      const Eigen::Vector3d p = frame.world_of(x + 0.5, y + 0.5);
      v.value(y, x) = static_cast<float>(1.0 - hidden(p.x(), light.centre.x()) *
                                                   hidden(p.y(), light.centre.y()));
    }
  }
  return v;
}

TEST(Reproject, AgreesWithTheRayTracedShadow) {
  const PlaneFrame frame = ground_frame();
  const std::vector<render::SquareLight> lights{light_at(15.0, 45.0), light_at(-105.0, 15.0)};
  const std::vector<Eigen::Vector3d> weights(2, Eigen::Vector3d::Ones());
  for (const double height : {-80.0, 0.0, 20.0}) {
    const render::Scene scene = flat_receiver(height);
    const Image<float> truth =
        trace_shadow(scene, hovering_plate(), camera_from_above(), lights, weights, 1);
    ReprojectOptions options = plain_options();
    options.object = HeightRange{100.0, 100.0};
    const ReprojectResult result = reproject_shadow(
        scene, camera_from_above(), frame, lights, weights,
        [&](int k) { return plate_shadow(frame, lights[static_cast<std::size_t>(k)]); },
        options);
    double error = 0.0;
    double norm = 0.0;
    for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
      const auto t = static_cast<double>(truth.pixels()[i]);
      error += std::pow(static_cast<double>(result.picture.pixels()[i]) - t, 2);
      norm += t * t;
    }
    RecordProperty("relative_l2_at_" + std::to_string(static_cast<int>(height)),
                   std::to_string(std::sqrt(error / norm)));
    EXPECT_LT(std::sqrt(error / norm), 0.03) << height;  // 2 mm pixels across a 3.5 mm penumbra
  }
}

TEST(ShadowError, CountsShadowAndKnownPositionsByHand) {
  // Four values: lit and known, half wrong shadow, unknown, and one where no receiver is.
  ReprojectResult result;
  result.picture = result.unshadowed = result.unseen = Image<float>(1, 4, 1);
  const std::vector<float> picture = {1.0F, 0.5F, 0.5F, 0.0F};
  const std::vector<float> unshadowed = {1.0F, 1.0F, 1.0F, 0.0F};
  const std::vector<float> unseen = {0.0F, 0.0F, 0.5F, 0.0F};
  const std::vector<float> traced = {1.0F, 0.0F, 1.0F, 0.0F};
  Image<float> truth(1, 4, 1);
  for (std::size_t i = 0; i < 4; ++i) {
    result.picture.pixels()[i] = picture[i];
    result.unshadowed.pixels()[i] = unshadowed[i];
    result.unseen.pixels()[i] = unseen[i];
    truth.pixels()[i] = traced[i];
  }
  const ShadowError error = compare_shadow(result, truth);
  EXPECT_DOUBLE_EQ(error.wrong_fraction, 1.0);        // (0.5 + 0.5)/1
  EXPECT_DOUBLE_EQ(error.known_wrong_fraction, 0.5);  // 0.5/1
  EXPECT_DOUBLE_EQ(error.known_relative_l2, 0.5);     // sqrt(0.25/1)
  EXPECT_DOUBLE_EQ(error.known_fraction, 2.0 / 3.0);
  EXPECT_FALSE(error.spread);
}

TEST(ShadowError, SaysHowOftenTheSpreadHoldsTheTruth) {
  struct Value {
    float picture;
    float truth;
    float spread;
    float told;
    bool counts;
    bool holds;
  };
  const std::vector<Value> values{
      {1.0F, 1.0F, 0.0F, 1.0F, false, true},   // lit
      {0.0F, 0.01F, 0.0F, 0.0F, false, true},  // measured, all dark
      {0.0F, 0.01F, 0.0F, 1.0F, true, false},  // dark, but an occluder told
      {0.5F, 0.25F, 0.3F, 0.0F, true, true},   //
      {1.0F, 0.5F, 0.25F, 0.0F, true, false},  // a shadow that was lost
      {0.5F, 1.0F, 0.5F, 1.0F, true, true},    // one that is none
  };
  const int n = static_cast<int>(values.size());
  ReprojectResult result;
  result.picture = result.unseen = result.spread = result.unshadowed = Image<float>(1, n, 3);
  result.from_occluder = Image<float>(1, n, 1);
  result.has_spread = true;
  Image<float> truth(1, n, 3);
  double n_counted = 0.0;
  double n_held = 0.0;
  double square = 0.0;
  for (int x = 0; x < n; ++x) {
    const Value& value = values[static_cast<std::size_t>(x)];
    for (int c = 0; c < 3; ++c) {
      result.unshadowed(0, x, c) = 8.0F;
      result.picture(0, x, c) = 8.0F * value.picture;
      result.spread(0, x, c) = 8.0F * value.spread;
      truth(0, x, c) = 8.0F * value.truth;
    }
    result.from_occluder(0, x) = value.told;
    if (value.counts) {
      n_counted += 1.0;
      n_held += value.holds ? 1.0 : 0.0;
      square += std::pow(static_cast<double>(value.picture - value.truth), 2);
    }
  }
  const ShadowError error = compare_shadow(result, truth);
  ASSERT_TRUE(error.spread);
  EXPECT_NEAR(error.spread->holding_fraction, n_held / n_counted, 1e-12);
  EXPECT_NEAR(error.spread->median, 0.275, 1e-6);  // of 0, 0.25, 0.3, 0.5
  EXPECT_NEAR(error.spread->mean_error, (0.01 + 0.25 + 0.5 + 0.5) / 4.0, 1e-6);
  EXPECT_NEAR(error.spread->rms_error, std::sqrt(square / n_counted), 1e-6);
}

TEST(ShadowTruth, GroundInThePlaneIsNoObject) {
  render::Scene scene;
  scene.materials.push_back({"white", Eigen::Vector3d::Constant(0.5), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-9, -9, 0}, {9, -9, 0}, {9, 9, 0}, {-9, 9, 0}, 0));
  scene.meshes.push_back(render::make_quad({-9, 0, 0}, {9, 0, 0}, {9, 0, 5}, {-9, 0, 5}, 0));
  remove_plane_triangles(scene, ground_frame());
  ASSERT_EQ(scene.meshes.size(), 1U);
  EXPECT_EQ(scene.meshes[0].triangles.size(), 2U);  // it only stands on the plane
}

}  // namespace
}  // namespace haarlight::relight
