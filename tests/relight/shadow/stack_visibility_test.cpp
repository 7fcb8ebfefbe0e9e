// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/stack_visibility.h"

#include <atomic>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/shadow/receiver_light.h"
#include "haarlight/render/direct/picture.h"
#include "relight/shadow/reproject.h"

namespace haarlight::relight {
namespace {

constexpr int kLights = 36;

/// A small rig: 6 x 6 lights over the plane, a camera of 80 x 60.
std::vector<render::SquareLight> rig_of_lights() {
  std::vector<render::SquareLight> lights;
  for (int i = 0; i < kLights; ++i) {
    render::SquareLight light;
    light.centre = {150.0 * (i % 6 - 2.5), 150.0 * (i / 6 - 2.5), 900.0};  // NOLINT
    light.width_mm = light.height_mm = 60.0;
    lights.push_back(light);
  }
  return lights;
}

CameraModel test_camera() {
  CameraModel camera;
  camera.width = 80;
  camera.height = 60;
  camera.fx = camera.fy = 110.0;
  camera.cx = 40.0;
  camera.cy = 30.0;
  camera.world_from_cam =
      look_at({0.0, -560.0, 520.0}, {0.0, 0.0, 20.0}, Eigen::Vector3d::UnitZ());
  return camera;
}

PlaneFrame ground_frame() {
  ShadowPlane plane;
  plane.extent_u_mm = plane.extent_v_mm = 300.0;
  plane.texel_mm = 6.0;
  return make_plane_frame(plane);
}

/// A box over a wide ground.
render::Scene box_on_ground(double albedo) {
  render::Scene scene;
  scene.materials.push_back({"ground", Eigen::Vector3d::Constant(0.8), 0.0, 1.0});
  scene.materials.push_back({"box", Eigen::Vector3d::Constant(albedo), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-2000, -2000, 0}, {2000, -2000, 0}, {2000, 2000, 0},
                                           {-2000, 2000, 0}, 0));
  scene.meshes.push_back(render::make_box({-30, -30, 20}, {30, 30, 60}, 1));
  return scene;
}

struct Twin {
  MemoryStack stack{{80, 60, 1, kLights}};
  Image<std::uint8_t> shows_plane{60, 80, 1};
};

/// The stack of that scene in units of its own (times 5), with noise.
Twin photograph(double noise, double albedo = 0.3) {
  const render::Scene scene = box_on_ground(albedo);
  const render::RayCaster caster(scene);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const render::DirectLight direct(caster, lights);
  Twin twin;
  std::vector<render::LightContribution> contributions(lights.size());
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 80; ++x) {
      const auto seen = render::visible_surface(caster, test_camera(), x + 0.5, y + 0.5);
      if (!seen) {
        continue;
      }
      const render::Material& material =
          scene.materials[static_cast<std::size_t>(seen->material)];
      const std::uint64_t key =
          std::uint64_t{80} * static_cast<std::uint64_t>(y) + static_cast<std::uint64_t>(x);
      (void)direct.evaluate(*seen, material, key, contributions);
      twin.shows_plane(y, x) = seen->material == 0 ? 1 : 0;
      for (int k = 0; k < kLights; ++k) {
        const double t =
            5.0 * material.kd.x() * contributions[static_cast<std::size_t>(k)].diffuse;
        const auto light = static_cast<std::uint64_t>(k);
        twin.stack.at(0, y, x, k) =
            static_cast<float>(t * (1.0 + noise * standard_normal(hash_key(key, light))));
      }
    }
  }
  return twin;
}

std::vector<int> all_lights() {
  std::vector<int> all(kLights);
  for (int k = 0; k < kLights; ++k) {
    all[static_cast<std::size_t>(k)] = k;
  }
  return all;
}

TEST(StackVisibility, FindsScaleObjectAndShadow) {
  const Twin twin = photograph(0.01);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, lights, PlateKind::squares);
  StackVisibility visibility(twin.stack, plate, test_camera(), frame, all_lights());
  // T = 5 * 0.8/pi * E, the plate 1e6 E/(60 * 60).
  EXPECT_NEAR(visibility.scale() / (5.0 * 0.8 / std::numbers::pi * 3600.0 / 1e6), 1.0, 0.005);
  int n_object_kept = 0;
  int n_plane_lost = 0;
  for (int y = 1; y < 59; ++y) {
    for (int x = 1; x < 79; ++x) {
      const bool is_inner = twin.shows_plane(y, x) == twin.shows_plane(y, x - 1) &&
                            twin.shows_plane(y, x) == twin.shows_plane(y - 1, x) &&
                            twin.shows_plane(y, x) == twin.shows_plane(y, x + 1) &&
                            twin.shows_plane(y, x) == twin.shows_plane(y + 1, x);
      if (!is_inner) {
        continue;
      }
      n_object_kept +=
          twin.shows_plane(y, x) == 0 && visibility.shows_plane()(y, x) != 0 ? 1 : 0;
      n_plane_lost +=
          twin.shows_plane(y, x) != 0 && visibility.shows_plane()(y, x) == 0 ? 1 : 0;
    }
  }
  EXPECT_EQ(n_object_kept, 0);
  EXPECT_LT(n_plane_lost, 160);  // of 4500: the rim of one pixel round the box, deep shadow
  // Against the fraction of each light that the plane pixel's middle really sees.
  render::Scene box = box_on_ground(0.3);
  box.meshes.erase(box.meshes.begin());
  const render::RayCaster caster(box);
  const render::DirectLight direct(caster, lights);
  std::vector<render::LightContribution> contributions(lights.size());
  double error = 0.0;
  double n = 0.0;
  for (int k = 0; k < kLights; k += 7) {
    const Visibility v = visibility.visibility(k);
    EXPECT_EQ(v.count.n_no_plate, 0U);
    for (int y = 0; y < frame.height; y += 3) {
      for (int x = 0; x < frame.width; x += 3) {
        if (v.known(y, x) == 0) {
          continue;
        }
        const render::SurfacePoint point{frame.world_of(x + 0.5, y + 0.5),
                                         Eigen::Vector3d::UnitZ(), Eigen::Vector3d::UnitZ(),
                                         Eigen::Vector3d::UnitZ(), 0};
        (void)direct.evaluate(point, render::Material{}, 1, contributions);
        const double e = static_cast<double>(v.value(y, x)) -
                         contributions[static_cast<std::size_t>(k)].visible;
        error += e * e;
        n += 1.0;
      }
    }
  }
  ASSERT_GT(n, 500.0);
  EXPECT_LT(std::sqrt(error / n), 0.06);  // camera pixels of 7 mm across edges of 4 mm
}

/// Object pixels, without the outline, that are taken for the plane.
int count_mistaken(const Twin& twin, const StackVisibility& visibility) {
  int n = 0;
  for (int y = 1; y < 59; ++y) {
    for (int x = 1; x < 79; ++x) {
      n += twin.shows_plane(y, x) == 0 && visibility.shows_plane()(y, x) != 0 ? 1 : 0;
    }
  }
  return n;
}

TEST(StackVisibility, TheHeightTellsATopAsBrightAsThePlane) {
  const Twin twin = photograph(0.01, 0.66);  // 60 mm nearer to the lights: its top is as bright
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, lights, PlateKind::squares);
  const StackVisibility by_brightness(twin.stack, plate, test_camera(), frame, {0});
  StackVisibilityOptions options;
  options.lights = lights;
  const StackVisibility by_height(twin.stack, plate, test_camera(), frame, {0}, options);
  EXPECT_GT(count_mistaken(twin, by_brightness), 30);
  EXPECT_EQ(count_mistaken(twin, by_height), 0);
  // And takes no more of the plane away than the object's rim of one pixel.
  int n_lost = 0;
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 80; ++x) {
      n_lost += twin.shows_plane(y, x) != 0 && by_height.shows_plane()(y, x) == 0 &&
                        by_brightness.shows_plane()(y, x) != 0
                    ? 1
                    : 0;
    }
  }
  EXPECT_LT(n_lost, 80);
}

TEST(StackVisibility, NoiseDoesNotDarkenWhatIsLit) {
  const Twin twin = photograph(0.01);
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, rig_of_lights(), PlateKind::squares);
  StackVisibility visibility(twin.stack, plate, test_camera(), frame, {14});
  const Visibility v = visibility.visibility(14);
  double lost = 0.0;
  double n = 0.0;
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      // Light 14 is 75 mm from the middle; the box's shadow ends 45 mm from it.
      const Eigen::Vector3d p = frame.world_of(x + 0.5, y + 0.5);
      if (v.known(y, x) != 0 && p.head<2>().cwiseAbs().maxCoeff() > 60.0) {
        lost += 1.0 - static_cast<double>(v.value(y, x));
        n += 1.0;
      }
    }
  }
  ASSERT_GT(n, 1000.0);
  // Clamped noise of 1 % would lose 0.4 % on the mean.
  EXPECT_LT(lost / n, 0.0005);
}

TEST(StackVisibility, DoesNotDependOnTheMemory) {
  const Twin twin = photograph(0.0);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, lights, PlateKind::squares);
  StackVisibility large(twin.stack, plate, test_camera(), frame, {0, 5, 35});
  StackVisibilityOptions options;
  options.memory_bytes = 1;
  StackVisibility small(twin.stack, plate, test_camera(), frame, {0, 5, 35}, options);
  for (const int k : {0, 5, 35, 0}) {
    const Visibility a = large.visibility(k);
    const Visibility b = small.visibility(k);
    EXPECT_TRUE(
        std::equal(a.value.pixels().begin(), a.value.pixels().end(), b.value.pixels().begin()));
  }
  EXPECT_THROW((void)large.visibility(1), ContractViolation);
}

/// Counts how often its pixels are read.
class CountedStack final : public StackSource {
 public:
  explicit CountedStack(const StackSource& stack) : stack_(stack) {}
  [[nodiscard]] StackDims dims() const override { return stack_.dims(); }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    n_pixels_ += static_cast<std::uint64_t>(rect.n_pixels());
    stack_.read_tile(rect, out);
  }
  /// Of all pixels since the last call.
  [[nodiscard]] double readings() {
    return static_cast<double>(n_pixels_.exchange(0)) /
           static_cast<double>(stack_.dims().n_pixels());
  }

 private:
  const StackSource& stack_;
  mutable std::atomic<std::uint64_t> n_pixels_{0};
};

TEST(StackVisibility, WhatWasFoundIsNotSearchedAgain) {
  const Twin twin = photograph(0.0);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, lights, PlateKind::squares);
  StackVisibility searched(twin.stack, plate, test_camera(), frame, {0, 5, 35});
  CountedStack counted(twin.stack);
  StackVisibilityOptions options;
  options.found = searched.found();
  StackVisibility taken(counted, plate, test_camera(), frame, {35, 5}, options);
  EXPECT_EQ(taken.scale(), searched.scale());
  EXPECT_EQ(taken.known_fraction(), searched.known_fraction());
  for (const int k : {35, 5}) {
    const Visibility a = searched.visibility(k);
    const Visibility b = taken.visibility(k);
    EXPECT_TRUE(std::ranges::equal(a.value.pixels(), b.value.pixels()));
    EXPECT_TRUE(std::ranges::equal(a.known.pixels(), b.known.pixels()));
  }
  EXPECT_EQ(counted.readings(), 1.0);  // for both pictures
}

TEST(StackVisibility, ReadsTheStackAgainOnlyForPicturesThatDoNotFit) {
  const Twin twin = photograph(0.0);
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, rig_of_lights(), PlateKind::squares);
  CountedStack stack(twin.stack);
  const auto ask_for_all = [](StackVisibility& visibility) {
    for (const int k : all_lights()) {
      (void)visibility.visibility(k);
    }
  };
  StackVisibility large(stack, plate, test_camera(), frame, all_lights());
  EXPECT_EQ(stack.readings(),
            2.0);  // for g (this stack has fewer than 100 tiles), for the plane
  ask_for_all(large);
  ask_for_all(large);
  EXPECT_EQ(stack.readings(), 0.0);
  // A third of the pictures fit: the first third comes with the plane, then one reading for
  // each of the others; asked again, three.
  StackVisibilityOptions options;
  options.memory_bytes = sizeof(float) * 80 * 60 * kLights / 3;
  StackVisibility small(stack, plate, test_camera(), frame, all_lights(), options);
  EXPECT_EQ(stack.readings(), 2.0);
  ask_for_all(small);
  EXPECT_EQ(stack.readings(), 2.0);
  ask_for_all(small);
  EXPECT_EQ(stack.readings(), 3.0);
}

TEST(StackVisibility, TakesAFittedFalloffWithoutAPlate) {
  const Twin twin = photograph(0.0);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate squares(test_camera(), frame.plane, lights, PlateKind::squares);
  const RigPlate points(test_camera(), frame.plane, lights, PlateKind::points);
  StackVisibility a(twin.stack, squares, test_camera(), frame, {3});
  StackVisibility b(twin.stack, points, test_camera(), frame, {3});
  const Visibility va = a.visibility(3);
  const Visibility vb = b.visibility(3);
  for (std::size_t i = 0; i < va.value.pixels().size(); ++i) {
    if (va.known.pixels()[i] != 0 && vb.known.pixels()[i] != 0) {
      // A 60 mm square 900 mm away is a point to (60/900)^2/4.
      EXPECT_NEAR(va.value.pixels()[i], vb.value.pixels()[i], 0.004);
    }
  }
}

TEST(StackVisibility, TakesAMaskAndRefusesWhatDoesNotFit) {
  const Twin twin = photograph(0.0);
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const PlaneFrame frame = ground_frame();
  const RigPlate plate(test_camera(), frame.plane, lights, PlateKind::squares);
  StackVisibilityOptions options;
  options.shows_plane = Image<std::uint8_t>(60, 80, 1);  // nothing is the plane
  const StackVisibility hidden(twin.stack, plate, test_camera(), frame, {0}, options);
  EXPECT_EQ(hidden.known_fraction(), 0.0);
  const MemoryStack black({80, 60, 1, kLights});
  EXPECT_THROW(StackVisibility(black, plate, test_camera(), frame, {0}), Error);
  EXPECT_THROW(StackVisibility(twin.stack, black, test_camera(), frame, {0}), Error);
  const MemoryStack other({80, 60, 1, 3});
  EXPECT_THROW(StackVisibility(twin.stack, other, test_camera(), frame, {0}), Error);
}

TEST(RigPlate, OfSomeLightsIsTheSame) {
  const RigPlate plate(test_camera(), {}, rig_of_lights(), PlateKind::squares);
  std::vector<float> all(std::size_t{4} * kLights);
  plate.read_tile({40, 30, 2, 2}, all);
  std::vector<float> some(std::size_t{4} * 2);
  plate.read_lights({40, 30, 2, 2}, std::vector<int>{17, 3}, some);
  for (std::size_t p = 0; p < 4; ++p) {
    EXPECT_EQ(some[2 * p], all[p * kLights + 17]);
    EXPECT_EQ(some[2 * p + 1], all[p * kLights + 3]);
  }
}

TEST(RigPlate, AgreesWithTheExactIrradiance) {
  const std::vector<render::SquareLight> lights = rig_of_lights();
  const RigPlate plate(test_camera(), {}, lights, PlateKind::squares);
  std::vector<float> values(std::size_t{4} * kLights);
  plate.read_tile({40, 30, 2, 2}, values);
  const CameraRay ray = ray_through(test_camera(), 41.5, 31.5);
  const Eigen::Vector3d p =
      ray.origin_world - ray.origin_world.z() / ray.direction_world.z() * ray.direction_world;
  for (int k = 0; k < kLights; ++k) {
    const double exact =
        receiver_irradiance(lights[static_cast<std::size_t>(k)], p, Eigen::Vector3d::UnitZ());
    EXPECT_NEAR(static_cast<double>(values[static_cast<std::size_t>(3 * kLights + k)]) /
                    (1e6 * exact / 3600.0),
                1.0, 1e-6);
  }
}

}  // namespace
}  // namespace haarlight::relight
