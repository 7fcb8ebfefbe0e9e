// SPDX-License-Identifier: Apache-2.0
#include "render/surface/vertex_lanes.h"

#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "render/bsdf/lambert.h"
#include "render/bsdf/shading_frame.h"
#include "render/sampling/sampler.h"
#include "render/surface/light_ray.h"
#include "render/surface/power_heuristic.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kRoundings = 1e-14;  // of a few dozen operations on unit vectors

double uniform(std::uint64_t i, std::uint64_t which) {
  return uniform_unit(hash_key(17, i, which));
}

Vector3d unit(std::uint64_t i, std::uint64_t which) {
  const double z = 2.0 * uniform(i, which) - 1.0;
  const Vector2d around = at_turns(uniform(i, which + 1));
  const double r = std::sqrt(1.0 - z * z);
  return {r * around.x(), r * around.y(), z};
}

Vector2d square(std::uint64_t i, std::uint64_t which) {
  return {uniform(i, which), uniform(i, which + 1)};
}

/// Vertices of a lane each, and lights of all kinds that are drawn by area.
struct Case {
  VertexLanes vertices{};
  LightLanes lights{};
  std::vector<Hit> hits = std::vector<Hit>(kLanes);
  std::vector<Vector2d> light_squares;
};

const Mesh& quad() {
  static const Mesh mesh =
      make_quad({-50, -50, 300}, {-50, 50, 300}, {50, 50, 280}, {50, -50, 280}, 0);
  return mesh;
}

std::vector<Light> area_lights() {
  SquareLight led;
  led.centre = {10, 20, 200};
  led.emits = -Vector3d::UnitZ();
  led.u = Vector3d::UnitX();
  led.v = -Vector3d::UnitY();
  led.width_mm = 12;
  led.height_mm = 20;
  led.lobe_mu = 2.5;
  led.radiance = 2.0;
  return {MeshLight(quad(), Vector3d(3, 2, 1)),
          DiskLight{{.centre = {0, 0, 250}, .normal = -Vector3d::UnitZ(), .radius_mm = 30},
                    Vector3d(1, 2, 3)},
          LedLight{led}};
}

constexpr double kLightOffset = 3e-4;  // mm
bool is_met(std::size_t lane) { return lane % 3 != 0; }

Case fill(std::uint64_t seed, const Light& light) {
  Case made;
  for (std::size_t lane = 0; lane < kLanes; ++lane) {
    const std::uint64_t i = kLanes * seed + lane;
    Hit& hit = made.hits[lane];
    hit.flat_normal = unit(i, 0);
    hit.normal = hit.flat_normal;
    hit.point = 100.0 * unit(i, 2);
    hit.offset_mm = 1e-4;
    made.vertices.put(lane, hit.normal, unit(i, 4), square(i, 6));
    made.light_squares.push_back(square(i, 8));
    const AreaPoint drawn = draw(light, made.light_squares[lane]);
    EXPECT_GT(drawn.density_per_mm2, 0.0);
    made.lights.put(lane, hit, drawn, 0.25, lane % 2 == 0, kLightOffset, is_met(lane));
  }
  made.vertices.find(kLanes);
  made.lights.find(kLanes, made.vertices);
  return made;
}

TEST(VertexLanes, AreFramesAndDirections) {
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    const Case made = fill(seed, area_lights()[0]);
    const VertexLanes& lanes = made.vertices;
    for (std::size_t lane = 0; lane < kLanes; ++lane) {
      const std::uint64_t i = kLanes * seed + lane;
      const Eigen::Matrix3d frame = frame_of(lanes.normal[lane]);
      EXPECT_EQ(lanes.first[lane], frame.col(0));
      EXPECT_EQ(lanes.second[lane], frame.col(1));
      EXPECT_LE((lanes.to_eye[lane] + frame.transpose() * unit(i, 4)).norm(), kRoundings);
      EXPECT_EQ(lanes.cosine_local[lane], cosine_direction(square(i, 6)));
      EXPECT_LE((lanes.cosine_world[lane] - frame * lanes.cosine_local[lane]).norm(),
                kRoundings);
    }
  }
}

TEST(LightLanes, AreWhatSampleAnswers) {
  for (const Light& light : area_lights()) {
    int n_found = 0;
    for (std::uint64_t seed = 0; seed < 200; ++seed) {
      const Case made = fill(seed, light);
      const LightLanes& lanes = made.lights;
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const LightSample asked =
            sample(light, made.hits[lane].point, made.light_squares[lane]);
        ASSERT_EQ(lanes.towards[lane] > 0.0, asked.is_found);
        if (!asked.is_found) {
          continue;
        }
        ++n_found;
        EXPECT_NEAR(lanes.distance[lane], asked.distance_mm, kRoundings * asked.distance_mm);
        EXPECT_LE((lanes.direction[lane] - asked.direction).norm(), kRoundings);
        EXPECT_NEAR(lanes.density[lane], asked.density, kRoundings * asked.density);
        const Vector3d radiance =
            area_radiance(light, lanes.towards[lane] / lanes.distance[lane]);
        EXPECT_LE((radiance - asked.radiance).norm(), kRoundings * asked.radiance.norm());
        const Vector3d local =
            frame_of(made.vertices.normal[lane]).transpose() * asked.direction;
        EXPECT_LE((lanes.local[lane] - local).norm(), kRoundings);
        EXPECT_NEAR(lanes.height[lane], made.hits[lane].flat_normal.dot(asked.direction),
                    kRoundings);
        if (local.z() > 1e-3) {
          const Lambert lambert{.kd = Vector3d::Ones()};
          const double density = 0.25 * asked.density;
          const double weight =
              lane % 2 == 0
                  ? power_heuristic(density, lambert.density(Vector3d::UnitZ(), local))
                  : 1.0;
          const double scale = weight * local.z() / density;
          EXPECT_NEAR(lanes.cosine_scale[lane], scale, 1e-11 * scale);  // of z / 1e-3
        }
      }
    }
    EXPECT_GT(n_found, 1000);
  }
}

TEST(LightLanes, TheirRaysAreThoseOfLightRay) {
  for (const Light& light : area_lights()) {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      const Case made = fill(seed, light);
      const LightLanes& lanes = made.lights;
      for (std::size_t lane = 0; lane < kLanes; ++lane) {
        const LightSample sample{
            .direction = lanes.direction[lane],
            .distance_mm = lanes.distance[lane],
            .normal = is_met(lane) ? lanes.normal[lane] : Vector3d(Vector3d::Zero())};
        const Ray ray = light_ray(made.hits[lane], sample, kLightOffset);
        EXPECT_EQ(lanes.ray_origin[lane], ray.origin);
        EXPECT_EQ(lanes.ray_direction[lane], ray.direction);
        EXPECT_EQ(ray.t_max, 1.0);
      }
    }
  }
}

TEST(LightLanes, OtherLightsAreNotDrawnByArea) {
  const auto density = [](const Light& light) {
    return draw(light, Vector2d(0.5, 0.5)).density_per_mm2;
  };
  EXPECT_EQ(density(SphereLight{.sphere = {}, .radiance = Vector3d::Ones()}), 0.0);
  EXPECT_EQ(density(PointSource{}), 0.0);
  EXPECT_EQ(density(DirectionalSource{.light = {}, .scene_radius_mm = 1.0}), 0.0);
}

}  // namespace
}  // namespace haarlight::render
