// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/relight/calibration/mirror_sphere.h"
#include "relight/calibration/near_calibration.h"
#include "tests/extremes.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::refused;
using extremes::stated;

// ---- a sheet of paper ----

EXTREMES_OF(sheet, "relight/calibration", "near lights from a matte sheet")

SimulatedTarget small_target(int n = 12) {
  SimulatedTarget target;
  target.rows = target.cols = n;
  target.albedo_spread = 0.1;
  target.vignetting = 0.2;
  return target;
}

std::vector<NearLight> dome(int n, double height_mm = 250.0, std::uint64_t seed = 9) {
  std::vector<NearLight> lights;
  for (int k = 0; k < n; ++k) {
    const auto u = [&](std::uint64_t i) {
      return uniform_unit(hash_key(seed, static_cast<std::uint64_t>(k), i));
    };
    NearLight light;
    const double out = 250.0 * std::sqrt((k + 0.5) / n);
    light.position_mm = {out * std::cos(2.4 * k), out * std::sin(2.4 * k),
                         height_mm * (0.9 + 0.2 * u(0))};
    light.mu = 1.0;
    light.power = Vector3d(0.7 + 0.6 * u(1), 0.7 + 0.6 * u(2), 0.7 + 0.6 * u(3));
    lights.push_back(light);
  }
  return lights;
}

LightCalibration calibrated(const TargetSamples& s, const CalibrationOptions& options = {}) {
  return calibrate_free_lights(s, paper_start(s, 1.0), options);
}

/// The largest distance of a good light from its position in its own standard errors; every good
/// light is finite.
double worst_sigmas(const LightCalibration& found, const std::vector<NearLight>& truth) {
  double worst = 0.0;
  for (std::size_t k = 0; k < truth.size(); ++k) {
    EXPECT_TRUE(found.lights[k].light.position_mm.allFinite());
    if (found.lights[k].finding == LightFinding::good) {
      const Vector3d e = found.lights[k].light.position_mm - truth[k].position_mm;
      worst =
          std::max(worst, std::sqrt(e.dot(found.lights[k].sigma.position_mm2.ldlt().solve(e))));
    }
  }
  return worst;
}
constexpr const char* kSigmas =
    "a good light's distance from its true position, in standard errors";
constexpr const char* kSigmasWhy = "three coordinates, ten lights: 6 sigma once in 1e6";

EXTREME(sheet, dark) {
  TargetSamples black = simulate_target(dome(4), small_target(8));
  std::fill(black.intensity.begin(), black.intensity.end(), 0.0F);
  return refused("0 of 4 lights", [&] { (void)calibrated(black); });
}
EXTREME(sheet, one) {
  const TargetSamples s = simulate_target(dome(1), small_target(8));
  CalibrationOptions options;
  options.lobe = Lobe::given;
  const std::vector<NearLight> three = dome(3, 200.0);
  const LightCalibration found = calibrated(simulate_target(three, small_target()), options);
  return both(refused("of 1 lights have a usable sample", [&] { (void)calibrated(s); }),
              bounded(worst_sigmas(found, three), 6.0,
                      std::string("three lights, the lobe given: ") + kSigmas, kSigmasWhy));
}
NO_EXTREME(sheet, largest, "no limit")
NO_EXTREME(sheet, odd_size, "points in any order")
EXTREME(sheet, scale) {
  const std::vector<NearLight> lights = dome(10);
  double worst = 0.0;
  for (const float scale : {1e-10F, 1e20F}) {
    TargetSamples s = simulate_target(lights, small_target());
    for (float& value : s.intensity) {
      value *= scale;
    }
    s.noise.floor *= double{scale};
    s.noise.shot *= double{scale};
    CalibrationOptions options;
    options.mask.saturation *= double{scale};
    const LightCalibration found = calibrated(s, options);
    EXPECT_TRUE(found.is_usable()) << scale;
    worst = std::max(worst, worst_sigmas(found, lights));
  }
  return bounded(worst, 6.0, std::string("pictures 1e-10 and 1e20 times as bright: ") + kSigmas,
                 kSigmasWhy);
}
NO_EXTREME(sheet, subnormal, "pictures of 8 to 16 bits")
EXTREME(sheet, not_finite) {
  TargetSamples s = simulate_target(dome(4), small_target(8));
  s.intensity[5] = std::numeric_limits<float>::infinity();
  (void)refused("intensity 5 is not a finite number", [&] { (void)calibrated(s); });
  s.intensity[5] = std::numeric_limits<float>::quiet_NaN();
  return refused("intensity 5 is not a finite number", [&] { (void)calibrated(s); });
}
EXTREME(sheet, degenerate) {
  std::vector<NearLight> lights = dome(10);
  lights[4].position_mm = {400.0, 0.0, 0.0};
  const TargetSamples s = simulate_target(lights, small_target());
  const LightCalibration found = calibrated(s);
  EXPECT_EQ(found.lights[4].finding, LightFinding::unseen);
  EXPECT_EQ(found.lights[4].counts.used, 0);
  EXPECT_TRUE(found.is_usable());
  std::vector<NearLight> below = paper_start(s, 1.0);
  below[2].position_mm.z() = -5.0;
  return both(
      stated("a light in the target's plane: unseen, the others are found"),
      refused("light 2 starts 5 mm below", [&] { (void)calibrate_free_lights(s, below); }));
}
EXTREME(sheet, grazing) {
  std::vector<NearLight> lights = dome(10);
  lights[4].position_mm = {600.0, 0.0, 5.0};
  const LightCalibration found = calibrated(simulate_target(lights, small_target()));
  EXPECT_TRUE(found.is_usable());
  return bounded(
      worst_sigmas(found, lights), 6.0,
      std::string("a light 0.5° above the sheet, where it is called good: ") + kSigmas,
      kSigmasWhy);
}
EXTREME(sheet, far_near) {
  std::vector<NearLight> lights = dome(10, 250.0, 10);
  lights[4].position_mm = {2e4, 0.0, 2e5};
  lights[4].power *= 6e5;
  const LightCalibration found = calibrated(simulate_target(lights, small_target(24)));
  EXPECT_EQ(found.lights[4].finding, LightFinding::weak);
  // It lights a flat sheet evenly, from wherever: above all its distance is unknown.
  EXPECT_GT(found.lights[4].weak_mm, 1000.0);
  EXPECT_GT(std::abs(found.lights[4].weak_direction.z()), 0.9);
  EXPECT_TRUE(found.is_usable());
  return stated(
      "a thousand targets away: weak, with the direction along which its position is unknown; "
      "the "
      "others are found");
}
EXTREME(sheet, duplicate) {
  const std::vector<NearLight> same(5, dome(1)[0]);
  const TargetSamples s = simulate_target(same, small_target());
  std::vector<NearLight> two = dome(10);
  two[1].position_mm = two[0].position_mm;
  const LightCalibration found = calibrated(simulate_target(two, small_target()));
  EXPECT_TRUE(found.is_usable());
  return both(refused("do not say where", [&] { (void)calibrated(s); }),
              bounded(worst_sigmas(found, two), 6.0,
                      std::string("two of ten at the same position: ") + kSigmas, kSigmasWhy));
}
EXTREME(sheet, clipped) {
  const std::vector<NearLight> lights = dome(10);
  SimulatedTarget target = small_target();
  const TargetSamples clean = simulate_target(lights, target);
  target.bits = 16;
  target.saturation =
      0.7 * double{*std::max_element(clean.intensity.begin(), clean.intensity.end())};
  CalibrationOptions options;
  options.mask.saturation = 0.999999 * target.saturation;
  const LightCalibration found = calibrated(simulate_target(lights, target), options);
  EXPECT_TRUE(found.is_usable());
  std::int64_t n_saturated = 0;
  for (const CalibratedLight& light : found.lights) {
    n_saturated += light.counts.saturated;
  }
  EXPECT_GT(n_saturated, 0);
  return both(bounded(worst_sigmas(found, lights), 6.0,
                      std::string("cut at 0.7 of the brightest: ") + kSigmas, kSigmasWhy),
              stated("saturated samples are left out and counted"));
}

// ---- mirror balls ----

EXTREMES_OF(ball, "relight/calibration", "lights from mirror balls")

CameraModel camera_above() {
  CameraModel camera;
  camera.width = 1200;
  camera.height = 900;
  camera.fx = camera.fy = 1500.0;
  camera.cx = 600.0;
  camera.cy = 450.0;
  camera.world_from_cam = look_at({0.0, 0.0, 700.0}, {0.0, 0.0, 0.0}, {0.0, 1.0, 0.0});
  return camera;
}
const MirrorSphere kBall{{30.0, -20.0, 15.0}, 15.0};
const MirrorSphere kOther{{-60.0, 40.0, 15.0}, 15.0};

/// A picture of a ball with a bright disc on it.
Image<float> ball_picture(float value, double radius = 2.0) {
  Image<float> picture(60, 60, 1);
  for (int y = 0; y < 60; ++y) {
    for (int x = 0; x < 60; ++x) {
      picture(y, x) = std::hypot(x + 0.5 - 33.0, y + 0.5 - 27.0) < radius ? value : 0.0F;
    }
  }
  return picture;
}
constexpr PictureCircle kCircle{30.0, 30.0, 25.0, 0.0};

EXTREME(ball, dark) {
  return refused("the ball is black",
                 [] { (void)find_highlight(ball_picture(0.0F).view(), kCircle); });
}
EXTREME(ball, one) {
  const CameraModel camera = camera_above();
  const std::vector<ReflectedRay> one = {
      reflect_off(camera, kBall, glint_of(camera, kBall, {100.0, 50.0, 400.0}))};
  (void)refused("the rays do not meet", [&] { (void)intersect(one); });
  const std::vector<Vector2d> two = {{0.0, 0.0}, {1.0, 0.0}};
  return both(refused("the rays do not meet", [&] { (void)intersect(one); }),
              refused("no circle", [&] { (void)fit_circle(two); }));
}
NO_EXTREME(ball, largest, "the picture's size")
NO_EXTREME(ball, odd_size, "outlines are lists of points")
EXTREME(ball, scale) {
  double worst = 0.0;
  for (const double scale : {1e-30, 1e30}) {
    std::vector<Vector2d> points;
    for (int i = 0; i < 40; ++i) {
      points.emplace_back(
          scale * Vector2d(3.0 + 2.0 * std::cos(0.157 * i), -1.0 + 2.0 * std::sin(0.157 * i)));
    }
    worst = std::max(worst, std::abs(fit_circle(points).radius / (2.0 * scale) - 1.0));
  }
  for (const float scale : {1e-30F, 1e30F}) {
    const Vector2d at = find_highlight(ball_picture(scale).view(), kCircle);
    EXPECT_LT((at - Vector2d(33.0, 27.0)).norm(), 0.2);
  }
  return bounded(worst, 1e-10,
                 "outlines of 1e±30 pixels, pictures of 1e±30: relative error of the circle",
                 "a system of 3, 40 points of 2^-53");
}
EXTREME(ball, subnormal) {
  const Vector2d at = find_highlight(ball_picture(1e-40F).view(), kCircle);
  return bounded((at - Vector2d(33.0, 27.0)).norm(), 0.2,
                 "pictures of 1e-40: error of the highlight, pixels",
                 "a disc of 12 pixels on their grid");
}
EXTREME(ball, not_finite) {
  return refused("not finite at pixel (30, 10)", [] {
    Image<float> picture = ball_picture(1.0F);
    picture(10, 30) = std::numeric_limits<float>::quiet_NaN();
    (void)find_highlight(picture.view(), kCircle);
  });
}
EXTREME(ball, degenerate) {
  std::vector<Vector2d> line;
  for (int i = 0; i < 12; ++i) {
    line.emplace_back(i, 2.0 * i);
  }
  const std::vector<ReflectedRay> parallel = {{Vector3d::Zero(), Vector3d::UnitZ()},
                                              {Vector3d::UnitX(), Vector3d::UnitZ()}};
  return both(refused("no circle", [&] { (void)fit_circle(line); }),
              refused("the rays do not meet", [&] { (void)intersect(parallel); }));
}
EXTREME(ball, grazing) {
  // At the rim the ball mirrors what lies behind it.
  const Vector3d rim = mirror_direction(kCircle, {30.0 + 25.0 * (1.0 - 1e-12), 30.0});
  EXPECT_NEAR(rim.z(), -1.0, 1e-4);
  EXPECT_NEAR(rim.norm(), 1.0, 1e-12);
  return both(stated("a highlight 1e-12 inside the rim: the light is behind the ball"),
              refused("outside the ball", [] {
                (void)mirror_direction(kCircle, {60.0, 30.0});
              }));
}
EXTREME(ball, far_near) {
  const CameraModel camera = camera_above();
  double worst = 0.0;
  for (const double away : {17.0, 1e7}) {  // 2 mm above the ball; 1e7 mm
    const Vector3d light = kBall.centre_mm + away * Vector3d(0.2, 0.1, 1.0).normalized();
    const std::vector<ReflectedRay> rays = {
        reflect_off(camera, kBall, glint_of(camera, kBall, light)),
        reflect_off(camera, kOther, glint_of(camera, kOther, light))};
    const Vector3d to_light = (light - rays[0].origin_mm).normalized();
    worst = std::max(worst, rays[0].direction.cross(to_light).norm());
  }
  return bounded(worst, 1e-6, "2 mm and 1e7 mm from the ball: error of the reflected ray, rad",
                 "the glint is found to 1e-9 pixels of 0.5 mm");
}
EXTREME(ball, duplicate) {
  const CameraModel camera = camera_above();
  const ReflectedRay ray =
      reflect_off(camera, kBall, glint_of(camera, kBall, {100.0, 50.0, 400.0}));
  return refused("the rays do not meet", [&] {
    const std::vector<ReflectedRay> twice = {ray, ray};
    (void)intersect(twice);
  });
}
EXTREME(ball, clipped) {
  const Vector2d at = find_highlight(ball_picture(1.0F, 4.0).view(), kCircle);
  EXPECT_LT((at - Vector2d(33.0, 27.0)).norm(), 0.2);
  return both(bounded((at - Vector2d(33.0, 27.0)).norm(), 0.2,
                      "a highlight clipped flat: error of its middle, pixels",
                      "a disc of 50 pixels on their grid"),
              refused("not a highlight",
                      [] { (void)find_highlight(ball_picture(1.0F, 15.0).view(), kCircle); }));
}

}  // namespace
}  // namespace haarlight::relight
