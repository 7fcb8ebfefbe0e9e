// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/mirror_ball.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>

#include <Eigen/Dense>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Normal deviates by (seed, what, number).
class Noise {
 public:
  explicit Noise(std::uint64_t seed) : seed_(seed) {}
  double next() {
    const double a = std::max(uniform_unit(hash_key(seed_, 1, n_)), 1e-12);
    const double b = uniform_unit(hash_key(seed_, 2, n_++));
    return std::sqrt(-2.0 * std::log(a)) * std::cos(2.0 * std::numbers::pi * b);
  }

 private:
  std::uint64_t seed_;
  std::uint64_t n_ = 0;
};

CameraModel camera_above() {
  CameraModel camera;
  camera.width = camera.height = 2000;
  camera.fx = camera.fy = 5000.0;
  camera.cx = camera.cy = 1000.0;
  camera.world_from_cam = look_at({0.0, 0.0, 700.0}, {0, 0, 0}, {0, 1, 0});
  return camera;
}

/// A ball's outline as the camera sees it: the circle where rays touch.
std::vector<Vector2d> seen_outline(const CameraModel& camera, const MirrorSphere& sphere) {
  const Vector3d way = camera.centre_world() - sphere.centre_mm;
  const double cos_tangent = sphere.radius_mm / way.norm();
  const double sin_tangent = std::sqrt(1.0 - cos_tangent * cos_tangent);
  const Vector3d a = way.unitOrthogonal();
  const Vector3d b = way.normalized().cross(a);
  std::vector<Vector2d> out;
  for (int i = 0; i < 360; ++i) {
    const double t = 2.0 * std::numbers::pi * i / 360.0;
    const Vector3d n =
        cos_tangent * way.normalized() + sin_tangent * (std::cos(t) * a + std::sin(t) * b);
    out.push_back(project(camera, sphere.centre_mm + sphere.radius_mm * n).value());
  }
  return out;
}

/// Blurred by stretches of 10 degrees, `sigma` pixels each, and moved as a whole.
std::vector<Vector2d> with_errors(std::vector<Vector2d> outline, double sigma, double whole,
                                  Noise& noise) {
  Vector2d middle = Vector2d::Zero();
  for (const Vector2d& p : outline) {
    middle += p / static_cast<double>(outline.size());
  }
  const Vector3d shift(whole * noise.next(), whole * noise.next(), whole * noise.next());
  std::vector<double> stretch(36);
  for (double& s : stretch) {
    s = sigma * noise.next();
  }
  for (Vector2d& p : outline) {
    const Vector2d d = p - middle;
    const double turn = std::atan2(d.y(), d.x()) / (2.0 * std::numbers::pi) + 0.5;
    const auto bin = static_cast<std::size_t>(std::clamp(36.0 * turn, 0.0, 35.0));
    p += (stretch[bin] + shift[2]) * d.normalized() + shift.head<2>();
  }
  return outline;
}

std::vector<Vector3d> lamps() {
  std::vector<Vector3d> out;
  for (int k = 0; k < 12; ++k) {
    const double up = (25.0 + 4.8 * k) * std::numbers::pi / 180.0;
    out.emplace_back(500.0 * std::cos(up) * std::cos(2.4 * k),
                     500.0 * std::cos(up) * std::sin(2.4 * k), 500.0 * std::sin(up));
  }
  return out;
}

struct Scene {
  std::vector<MeasuredBall> balls;
  std::vector<std::vector<std::optional<BallHighlight>>> highlights;
};

constexpr double kRadius = 12.0;
const std::vector<Vector3d> kMiddles{
    {0, 0, 12}, {100, 0, 12}, {-70, 70, 12}, {0, -100, 12}, {60, 80, 12}};

/// @param whole  how far every outline as a whole is off, pixels
Scene made_scene(const CameraModel& camera, double whole, std::uint64_t seed) {
  Noise noise(seed);
  Scene out;
  for (const Vector3d& m : kMiddles) {
    MeasuredBall ball =
        measure_ball(with_errors(seen_outline(camera, {m, kRadius}), 0.3, whole, noise));
    ball.covariance.diagonal().array() += whole * whole;
    out.balls.push_back(std::move(ball));
  }
  for (const Vector3d& lamp : lamps()) {
    out.highlights.emplace_back();
    for (const Vector3d& m : kMiddles) {
      const Vector2d at = glint_of(camera, {m, kRadius}, lamp);
      out.highlights.back().push_back(
          BallHighlight{at + 0.3 * Vector2d(noise.next(), noise.next()), 0.3});
    }
  }
  return out;
}

TEST(BallPositions, AreAsExactAsTheySay) {
  const CameraModel camera = camera_above();
  const std::vector<double> radii(kMiddles.size(), kRadius);
  for (const double whole : {0.0, 0.5}) {
    double sum = 0.0;
    int n = 0;
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const Scene scene = made_scene(camera, whole, seed);
      const BallPositions found = ball_positions(camera, scene.balls, radii, scene.highlights);
      EXPECT_FALSE(found.is_model_wrong()) << seed << " " << found.chi2 / found.freedom;
      for (std::size_t k = 0; k < found.lights.size(); ++k) {
        const BallPosition& light = found.lights[k];
        EXPECT_EQ(light.freedom, 7);
        const Vector3d e = light.position_mm - lamps()[k];
        sum += e.dot(light.covariance_mm2.ldlt().solve(e)) / 3.0;
        ++n;
      }
    }
    const double normalised = std::sqrt(sum / n);
    RecordProperty("normalised_" + std::to_string(whole), std::to_string(normalised));
    EXPECT_GT(normalised, 0.7) << whole;
    EXPECT_LT(normalised, 1.5) << whole;
  }
}

TEST(BallPositions, OfExactRaysAreThoseOfTheLamps) {
  const CameraModel camera = camera_above();
  const std::vector<double> radii(kMiddles.size(), kRadius);
  Scene scene;
  for (const Vector3d& m : kMiddles) {
    scene.balls.push_back(measure_ball(seen_outline(camera, {m, kRadius})));
    // Ellipses: their distance from a circle is taken for noise, which costs nothing here.
  }
  for (const Vector3d& lamp : lamps()) {
    scene.highlights.emplace_back();
    for (const Vector3d& m : kMiddles) {
      scene.highlights.back().push_back(
          BallHighlight{glint_of(camera, {m, kRadius}, lamp), 0.1});
    }
  }
  scene.highlights[3][1].reset();  // hidden behind something
  const BallPositions found = ball_positions(camera, scene.balls, radii, scene.highlights);
  for (std::size_t k = 0; k < found.lights.size(); ++k) {
    EXPECT_LT((found.lights[k].position_mm - lamps()[k]).norm(), 1e-3) << k;
  }
  EXPECT_EQ(found.lights[3].freedom, 5);
  const BallScene where = ball_scene(camera, scene.balls, radii);
  EXPECT_NEAR(where.camera_mm, 700.0, 1e-3);
  EXPECT_LT((where.spheres[1].centre_mm - kMiddles[1]).norm(), 1e-3);
}

TEST(BallPositions, OfAWrongRadiusAreToldToBeWrong) {
  const CameraModel camera = camera_above();
  const Scene scene = made_scene(camera, 0.0, 1);
  std::vector<double> radii(kMiddles.size(), kRadius);
  radii[1] *= 1.15;
  EXPECT_TRUE(ball_positions(camera, scene.balls, radii, scene.highlights).is_model_wrong());
}

TEST(BallDirection, IsAsExactAsItSays) {
  const CameraModel camera = camera_above();
  for (const bool has_camera : {false, true}) {
    double sum = 0.0;
    int n = 0;
    for (std::uint64_t seed = 1; seed <= 60; ++seed) {
      Noise noise(seed);
      // Far: parallel light and, without a camera, parallel view.
      const MirrorSphere sphere{{30.0, -20.0, kRadius}, kRadius};
      const double up = (20.0 + static_cast<double>(seed)) * std::numbers::pi / 180.0;
      const Vector3d truth(std::cos(up) * 0.6, std::cos(up) * 0.8, std::sin(up));
      std::vector<Vector2d> outline;
      Vector2d at;
      if (has_camera) {
        outline = seen_outline(camera, sphere);
        at = glint_of(camera, sphere, 1e7 * truth);
      } else {
        for (int i = 0; i < 360; ++i) {
          const double t = 2.0 * std::numbers::pi * i / 360.0;
          outline.emplace_back(300.0 + 120.0 * std::cos(t), 200.0 + 120.0 * std::sin(t));
        }
        const Vector3d normal = (truth + Vector3d::UnitZ()).normalized();
        at = {300.0 + 120.0 * normal.x(), 200.0 - 120.0 * normal.y()};
      }
      MeasuredBall ball = measure_ball(with_errors(outline, 0.4, 0.5, noise));
      ball.covariance.diagonal().array() += 0.25;
      const BallHighlight highlight{at + 0.3 * Vector2d(noise.next(), noise.next()), 0.3};
      const BallDirection found =
          ball_direction(ball, highlight, has_camera ? &camera : nullptr);
      const double angle = (found.direction - truth).norm();
      sum += angle * angle / (2.0 * found.sigma_rad * found.sigma_rad);
      ++n;
    }
    const double normalised = std::sqrt(sum / n);
    RecordProperty(has_camera ? "normalised_camera" : "normalised_far",
                   std::to_string(normalised));
    EXPECT_GT(normalised, 0.7);
    EXPECT_LT(normalised, 1.5);
  }
}

TEST(MeasuredBall, IsRefusedWhereItIsNoCircle) {
  std::vector<Vector2d> arc;
  for (int i = 0; i < 100; ++i) {
    arc.emplace_back(50.0 * std::cos(0.01 * i), 50.0 * std::sin(0.01 * i));  // 57 degrees
  }
  EXPECT_THROW((void)measure_ball(arc), Error);
  Image<float> square(60, 60, 1);
  for (int y = 15; y < 45; ++y) {
    for (int x = 15; x < 45; ++x) {
      square(y, x) = 1.0F;
    }
  }
  EXPECT_THROW((void)ball_of_mask(square.view()), Error);
}

/// A disc that is darker than a wall with a pattern, its highlight elsewhere in each picture.
Image<float> picture_of_disc(int k, double wall) {
  Image<float> out(240, 320, 1);
  for (int y = 0; y < 240; ++y) {
    for (int x = 0; x < 320; ++x) {
      const double r = std::hypot(x + 0.5 - 171.3, y + 0.5 - 104.8) - 62.6;
      const double ball = std::clamp(0.5 - r, 0.0, 1.0);
      const double h =
          std::hypot(x + 0.5 - 160.0 - 6.0 * k, y + 0.5 - 95.0 - 11.0 * (k % 3)) < 3.0 ? 1.0
                                                                                       : 0.0;
      const double pattern = 1.0 + 0.3 * std::sin(0.11 * x) * std::cos(0.07 * y);
      out(y, x) = static_cast<float>(ball * (0.01 + h) + (1.0 - ball) * wall * pattern);
    }
  }
  return out;
}

TEST(FindCircles, FindsADiscBeforeAWall) {
  for (const double wall : {0.3, 0.03}) {
    BallPictures pictures;
    for (int k = 0; k < 6; ++k) {
      pictures.add(picture_of_disc(k, wall).view());
    }
    const Image<float> mean = pictures.mean();
    const std::vector<MeasuredBall> circles = find_circles(mean.view());
    ASSERT_FALSE(circles.empty());
    EXPECT_NEAR(circles[0].circle.x, 171.3, 0.3);
    EXPECT_NEAR(circles[0].circle.y, 104.8, 0.3);
    EXPECT_NEAR(circles[0].circle.radius, 62.6, 0.3);
    EXPECT_GT(circles[0].seen, 0.8);
  }
}

TEST(FindCircles, FindsNoneInNoise) {
  BallPictures pictures;
  Image<float> noise(200, 300, 1);
  for (std::size_t i = 0; i < noise.pixels().size(); ++i) {
    noise.pixels()[i] = static_cast<float>(0.2 + 0.1 * uniform_unit(hash_key(3, i)));
  }
  pictures.add(noise.view());
  const Image<float> mean = pictures.mean();
  for (const MeasuredBall& circle : find_circles(mean.view())) {
    EXPECT_LT(circle.circle.radius, 15.0);  // freckles; none has a highlight
  }
}

TEST(ChooseBalls, WantsHighlightsThatMoveAndOneCircle) {
  std::vector<MeasuredBall> circles(4);
  circles[0].circle = {100, 100, 50};
  circles[0].seen = 0.9;
  circles[1].circle = {101, 100, 50.5};  // the same again
  circles[1].seen = 0.85;
  circles[2].circle = {100, 100, 30};  // a rival within it
  circles[2].seen = 0.84;
  circles[3].circle = {300, 100, 50};
  circles[3].seen = 0.6;
  std::vector<BallEvidence> evidence(4, {10, 8.0});
  evidence[2].n_highlights = 3;  // most lights do not glint there
  BallChoice choice = choose_balls(circles, evidence, 10);
  EXPECT_EQ(choice.balls, (std::vector<std::size_t>{0, 3}));
  EXPECT_TRUE(choice.rivals.empty());
  evidence[2].n_highlights = 10;
  EXPECT_EQ(choose_balls(circles, evidence, 10).rivals, (std::vector<std::size_t>{2}));
  evidence[3].wander_px = 0.1;  // a lamp that is always on
  evidence[2].n_highlights = 0;
  choice = choose_balls(circles, evidence, 10);
  EXPECT_EQ(choice.balls, (std::vector<std::size_t>{0}));
}

TEST(ChromeBall, IsFoundWithoutItsMask) {
  const std::filesystem::path folder = "../shared/data/balls";
  if (!std::filesystem::exists(folder / "lights.txt")) {
    GTEST_SKIP() << folder << " is absent";
  }
  BallPictures pictures;
  std::vector<Image<float>> all;
  for (int i = 0; i < 12; ++i) {
    all.push_back(
        read_linear_image(folder / "chrome" / ("chrome." + std::to_string(i) + ".tga")));
    pictures.add(all.back().view());
  }
  const Image<float> mean = pictures.mean();
  const std::vector<MeasuredBall> circles = find_circles(mean.view());
  const PictureFile file = read_picture(folder / "chrome" / "chrome.mask.tga");
  const PictureCircle mask = ball_of_mask(file.pixels.view()).circle;
  ASSERT_FALSE(circles.empty());
  // The mask is painted; its edge and the light's step are 1.2 pixels apart at most.
  EXPECT_NEAR(circles[0].circle.x, mask.x, 1.3);
  EXPECT_NEAR(circles[0].circle.y, mask.y, 1.3);
  EXPECT_NEAR(circles[0].circle.radius, mask.radius, 1.3);
  std::ifstream list(folder / "lights.txt");
  int n = 0;
  list >> n;
  double sum = 0.0;
  for (int i = 0; i < 12; ++i) {
    Vector3d truth;
    list >> truth.x() >> truth.y() >> truth.z();
    const BallHighlight at =
        measure_highlight(all[static_cast<std::size_t>(i)].view(), circles[0].circle);
    const Vector3d found = ball_direction(circles[0], at, nullptr).direction;
    sum += std::acos(std::min(1.0, found.dot(truth.normalized()))) * 180.0 / std::numbers::pi;
  }
  RecordProperty("mean_degrees", std::to_string(sum / 12.0));
  EXPECT_LE(sum / 12.0, 2.8);  // by the mask 3.1
}

}  // namespace
}  // namespace haarlight::relight
