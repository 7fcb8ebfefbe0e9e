// SPDX-License-Identifier: Apache-2.0
/// @file
/// The shadow of a known object on the stair scene, reprojected from its plane pictures,
/// against the ray-traced truth: on every tread with every window. Prints the table of
/// docs/numerics/shadow.md.

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/parallel.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/shadow/reproject.h"
#include "relight/shadow/shadow_truth.h"

namespace haarlight::relight {
namespace {

constexpr const char* kRoot = HAARLIGHT_SOURCE_DIR;

/// Plane pictures of a capture that nothing hides and that has no noise: the fraction of each
/// light that a plane pixel's centre sees past the object.
std::vector<Visibility> ideal_capture(const PlaneFrame& frame, const render::Scene& object,
                                      std::span<const render::SquareLight> lights) {
  const render::RayCaster caster(object);
  const render::DirectLight direct(caster, lights);
  std::vector<Visibility> pictures;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    pictures.push_back({Image<float>(frame.height, frame.width, 1),
                        Image<std::uint8_t>(frame.height, frame.width, 1),
                        {}});
  }
  parallel_for(
      static_cast<std::size_t>(frame.height), 4, [&](std::size_t begin, std::size_t end) {
        std::vector<render::LightContribution> contributions(lights.size());
        for (std::size_t row = begin; row < end; ++row) {
          for (int x = 0; x < frame.width; ++x) {
            const int y = static_cast<int>(row);
            const render::SurfacePoint point{frame.world_of(x + 0.5, y + 0.5),
                                             Eigen::Vector3d::UnitZ(), Eigen::Vector3d::UnitZ(),
                                             Eigen::Vector3d::UnitZ(), 0};
            const auto key =
                static_cast<std::uint64_t>(y) * 100000 + static_cast<std::uint64_t>(x);
            (void)direct.evaluate(point, render::Material{}, key, contributions);
            for (std::size_t k = 0; k < lights.size(); ++k) {
              pictures[k].value(y, x) = static_cast<float>(contributions[k].visible);
              pictures[k].known(y, x) = 1;
            }
          }
        }
      });
  return pictures;
}

/// Height of the horizontal tread that a pixel shows; nothing on risers and outlines.
std::map<int, int> treads_of(const render::Scene& scene, const CameraModel& camera) {
  const render::RayCaster caster(scene);
  std::map<int, std::pair<int, double>> seen;
  for (const Receiver& receiver : find_receivers(scene, caster, camera, 2)) {
    auto& [count, height] = seen[receiver.pixel];
    const bool is_flat = receiver.surface.flat_normal.z() > 0.99;
    const bool is_same = count == 0 || std::abs(height - receiver.surface.point.z()) < 0.01;
    count = is_flat && is_same ? count + 1 : -100;
    height = receiver.surface.point.z();
  }
  std::map<int, int> treads;
  for (const auto& [pixel, tread] : seen) {
    if (tread.first == 4) {
      treads[pixel] = static_cast<int>(std::lround(tread.second));
    }
  }
  return treads;
}

struct TreadError {
  double relative_l2 = 0.0;   ///< over the tread
  double shadow_wrong = 0.0;  ///< ||result - truth||_1 / ||unshadowed - truth||_1
};

std::map<int, TreadError> errors_by_tread(const std::map<int, int>& treads,
                                          const Image<float>& result, const Image<float>& truth,
                                          const Image<float>& unshadowed) {
  struct Sums {
    double square = 0.0;
    double norm = 0.0;
    double wrong = 0.0;
    double shadow = 0.0;
  };
  std::map<int, Sums> sums;
  for (const auto& [pixel, height] : treads) {
    const std::size_t at = static_cast<std::size_t>(pixel) * 3 + 1;
    const auto r = static_cast<double>(result.pixels()[at]);
    const auto t = static_cast<double>(truth.pixels()[at]);
    const auto u = static_cast<double>(unshadowed.pixels()[at]);
    Sums& sum = sums[height];
    sum.square += (r - t) * (r - t);
    sum.norm += t * t;
    sum.wrong += std::abs(r - t);
    sum.shadow += std::abs(u - t);
  }
  std::map<int, TreadError> errors;
  for (const auto& [height, sum] : sums) {
    errors[height] = {std::sqrt(sum.square / sum.norm), sum.wrong / sum.shadow};
  }
  return errors;
}

class StairScene : public ::testing::Test {
 protected:
  StairScene() {
    rig_ = read_rig(std::filesystem::path(kRoot) / "configs/rigs/cube32.toml");
    stairs_ = render::read_scene(std::filesystem::path(kRoot) / "configs/scenes/stairs.toml");
    object_ =
        render::read_scene(std::filesystem::path(kRoot) / "configs/scenes/airplane.toml").scene;
    remove_plane_triangles(object_, make_plane_frame(rig_.planes[0]));
    camera_ = stairs_.camera;
    camera_.width = 160;
    camera_.height = 120;
    camera_.fx *= 0.5;
    camera_.fy *= 0.5;
    camera_.cx *= 0.5;
    camera_.cy *= 0.5;
  }

  void compare(const char* name, const std::vector<int>& chosen) {
    ShadowPlane plane = rig_.planes[0];
    plane.texel_mm = 1.0;
    plane.extent_u_mm = plane.extent_v_mm = 400.0;
    const PlaneFrame frame = make_plane_frame(plane);
    const std::vector<render::SquareLight> all = render::rig_lights(rig_);
    std::vector<render::SquareLight> lights;
    for (const int k : chosen) {
      lights.push_back(all[static_cast<std::size_t>(k)]);
    }
    const std::vector<Eigen::Vector3d> weights(lights.size(), Eigen::Vector3d::Ones());
    const std::vector<Visibility> capture = ideal_capture(frame, object_, lights);
    const Image<float> truth =
        trace_shadow(stairs_.scene, object_, camera_, lights, weights, 2);
    const std::map<int, int> treads = treads_of(stairs_.scene, camera_);
    struct Rule {
      const char* name;
      WindowRule rule;
      bool has_height;
    };
    for (const Rule& rule :
         {Rule{"none", WindowRule::none, false}, Rule{"plain", WindowRule::plain, false},
          Rule{"corrected", WindowRule::corrected, true}}) {
      ReprojectOptions options;
      options.rule = rule.rule;
      if (rule.has_height) {
        options.object = HeightRange{76.0, 128.0};
      }
      const ReprojectResult result = reproject_shadow(
          stairs_.scene, camera_, frame, lights, weights,
          [&](int k) { return capture[static_cast<std::size_t>(k)]; }, options);
      errors_[rule.name] = errors_by_tread(treads, result.picture, truth, result.unshadowed);
      for (const auto& [height, error] : errors_[rule.name]) {
        std::printf("| %s | %s | %+d | %.2f %% | %.1f %% |\n", name, rule.name, height,
                    100.0 * error.relative_l2, 100.0 * error.shadow_wrong);
      }
    }
  }

  Rig rig_;
  render::SceneFile stairs_;
  render::Scene object_;
  CameraModel camera_;
  std::map<std::string, std::map<int, TreadError>> errors_;
};

TEST_F(StairScene, OneLight) {
  std::printf(
      "| lights | window | tread mm | relative L2 | shadow wrong |\n|---|---|---|---|---|\n");
  compare("1", {528});
  // On the plane no window is needed and the truth is met.
  EXPECT_LT(errors_["none"].at(0).shadow_wrong, 0.05);
  // Below, the corrected window is the best of the three.
  for (const int height : {-100, -50}) {
    EXPECT_LT(errors_["corrected"].at(height).shadow_wrong,
              errors_["none"].at(height).shadow_wrong);
    EXPECT_LT(errors_["corrected"].at(height).shadow_wrong,
              errors_["plain"].at(height).shadow_wrong);
  }
  // Above, the window makes it worse: at 50 mm, where it is 1.6 mm wide; the 0.8 mm at 25 mm
  // are less than a pixel of the plane picture and change nothing.
  EXPECT_LT(errors_["none"].at(50).shadow_wrong, errors_["plain"].at(50).shadow_wrong);
  EXPECT_NEAR(errors_["none"].at(25).shadow_wrong, errors_["plain"].at(25).shadow_wrong, 1e-6);
  for (const int height : {25, 50}) {
    EXPECT_EQ(errors_["none"].at(height).shadow_wrong,
              errors_["corrected"].at(height).shadow_wrong);
  }
}

TEST_F(StairScene, NineLights) {
  compare("9", {165, 176, 186, 517, 528, 538, 837, 848, 858});
  EXPECT_LT(errors_["none"].at(0).shadow_wrong, 0.05);
  for (const int height : {-100, -50}) {
    EXPECT_LE(errors_["corrected"].at(height).shadow_wrong,
              errors_["none"].at(height).shadow_wrong);
  }
}

}  // namespace
}  // namespace haarlight::relight
