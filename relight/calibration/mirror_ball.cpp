// SPDX-License-Identifier: Apache-2.0
#include "relight/calibration/mirror_ball.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include <Eigen/Dense>
#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr const char* kWhere = "mirror ball";
constexpr int kBins = 36;
constexpr double kMostMiss = 0.05;  // of the radius: largest misfit of a ball's mask
constexpr double kRivalSeen = 0.1;
constexpr double kRivalAway = 0.05;
constexpr double kMostZ = 3.72;  // one sound calibration in 10 000

/// From a camera's frame (y down, z forward) to the picture's.
Vector3d in_picture(const Vector3d& v) { return {v.x(), -v.y(), -v.z()}; }

CameraModel at_origin(const CameraModel& camera) {
  CameraModel out = camera;
  out.world_from_cam = Eigen::Isometry3d::Identity();
  return out;
}

/// The outline for a perturbed circle: d is added to (x, y, radius).
std::vector<Vector2d> moved_outline(const MeasuredBall& ball, const Vector3d& d) {
  const Vector2d centre(ball.circle.x, ball.circle.y);
  std::vector<Vector2d> out;
  out.reserve(ball.outline.size());
  for (const Vector2d& p : ball.outline) {
    const Vector2d own = (p - centre) * (1.0 + d[2] / ball.circle.radius) + centre;
    out.emplace_back(own + d.head<2>());
  }
  return out;
}

}  // namespace

MeasuredBall measure_ball(std::vector<Vector2d> outline) {
  MeasuredBall ball;
  ball.circle = fit_circle(outline);
  std::array<double, kBins> sum{};
  std::array<int, kBins> n{};
  for (const Vector2d& p : outline) {
    const Vector2d d(p.x() - ball.circle.x, p.y() - ball.circle.y);
    const double turn = std::atan2(d.y(), d.x()) / (2.0 * std::numbers::pi) + 0.5;
    const auto bin = static_cast<std::size_t>(std::clamp(turn * kBins, 0.0, kBins - 1.0));
    sum[bin] += d.norm() - ball.circle.radius;
    ++n[bin];
  }
  Matrix3d m = Matrix3d::Zero();
  double squares = 0.0;
  int n_bins = 0;
  for (std::size_t i = 0; i < kBins; ++i) {
    if (n[i] == 0) {
      continue;
    }
    ++n_bins;
    const double angle =
        2.0 * std::numbers::pi * ((static_cast<double>(i) + 0.5) / kBins - 0.5);
    const Vector3d row(std::cos(angle), std::sin(angle), 1.0);
    m += row * row.transpose();
    squares += std::pow(sum[i] / n[i], 2);
  }
  if (n_bins < kBins / 3) {
    throw Error(fmt::format("the outline goes round {} % of a circle", 100 * n_bins / kBins),
                kWhere, "at least a third is needed: a picture that shows more of the ball");
  }
  ball.covariance = squares / (n_bins - 3) * m.inverse();
  ball.outline = std::move(outline);
  return ball;
}

MeasuredBall ball_of_mask(ImageView<const float> mask) {
  MeasuredBall ball = measure_ball(outline_points(mask));
  if (!(ball.circle.rms < kMostMiss * ball.circle.radius)) {
    throw Error(fmt::format("the mask is no circle: its outline misses one of radius {:.1f} by "
                            "{:.1f} pixels",
                            ball.circle.radius, ball.circle.rms),
                kWhere, "white on one ball, black around it; a mask for each ball");
  }
  return ball;
}

BallHighlight measure_highlight(ImageView<const float> picture, const PictureCircle& ball) {
  HighlightOptions options;
  BallHighlight out;
  out.at = find_highlight(picture, ball, options);
  double most = 0.0;
  const auto value = [&](int y, int x) {
    double v = 0.0;
    for (int c = 0; c < picture.channels(); ++c) {
      v += static_cast<double>(picture(y, x, c));
    }
    return v;
  };
  const int reach = std::max(3, static_cast<int>(0.3 * ball.radius));
  const int x0 = std::max(0, static_cast<int>(out.at.x()) - reach);
  const int x1 = std::min(picture.width() - 1, static_cast<int>(out.at.x()) + reach);
  const int y0 = std::max(0, static_cast<int>(out.at.y()) - reach);
  const int y1 = std::min(picture.height() - 1, static_cast<int>(out.at.y()) + reach);
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      most = std::max(most, value(y, x));
    }
  }
  double n = 0.0;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      n += value(y, x) >= options.fraction * most ? 1.0 : 0.0;
    }
  }
  // A blob of n pixels: those on its edge fall inside or outside by chance.
  const double blob = std::sqrt(std::max(n, 1.0) / std::numbers::pi);
  const double grid = 0.29 * std::sqrt(2.0 / (std::numbers::pi * std::max(blob, 0.5)));
  options.fraction = 0.5;
  Vector2d wide = out.at;
  try {
    wide = find_highlight(picture, ball, options);
  } catch (const Error&) {
    wide = out.at;  // half the ball is above half the peak: only the upper part counts
  }
  // Two thresholds that disagree by d: each is off by d / sqrt(2), in two coordinates.
  out.sigma_px = std::hypot(grid, 0.5 * (wide - out.at).norm());
  return out;
}

BallChoice choose_balls(std::span<const MeasuredBall> circles,
                        std::span<const BallEvidence> evidence, int n_pictures) {
  HAARLIGHT_EXPECTS(circles.size() == evidence.size(), "evidence of each circle");
  BallChoice out;
  for (std::size_t i = 0; i < circles.size(); ++i) {
    const PictureCircle& a = circles[i].circle;
    // Highlights that do not move belong to something else shiny.
    const bool is_ball = 5 * evidence[i].n_highlights >= 4 * n_pictures &&
                         (n_pictures < 2 || evidence[i].wander_px > 0.01 * a.radius);
    if (!is_ball) {
      continue;
    }
    bool is_free = true;
    for (const std::size_t j : out.balls) {
      const PictureCircle& b = circles[j].circle;
      const double apart = std::hypot(a.x - b.x, a.y - b.y);
      if (apart > 0.9 * (a.radius + b.radius)) {
        continue;
      }
      is_free = false;
      const double away = std::max(apart, std::abs(a.radius - b.radius));
      if (circles[i].seen > circles[j].seen - kRivalSeen && away > kRivalAway * b.radius) {
        out.rivals.push_back(i);
      }
    }
    if (is_free) {
      out.balls.push_back(i);
    }
  }
  return out;
}

// ---- lights ----

namespace {

Vector3d direction_of(const MeasuredBall& ball, const Vector3d& moved, const Vector2d& at,
                      const CameraModel* camera) {
  if (camera == nullptr) {
    PictureCircle circle = ball.circle;
    circle.x += moved[0];
    circle.y += moved[1];
    circle.radius += moved[2];
    return mirror_direction(circle, at);
  }
  const CameraModel own = at_origin(*camera);
  const MirrorSphere sphere = sphere_from_outline(own, moved_outline(ball, moved), 1.0);
  return in_picture(reflect_off(own, sphere, at).direction);
}

}  // namespace

BallDirection ball_direction(const MeasuredBall& ball, const BallHighlight& highlight,
                             const CameraModel* camera) {
  constexpr double kStep = 0.05;  // pixels
  BallDirection out;
  out.direction = direction_of(ball, Vector3d::Zero(), highlight.at, camera);
  Matrix3d covariance = Matrix3d::Zero();
  Matrix3d j;
  for (int i = 0; i < 3; ++i) {
    const Vector3d d = kStep * Vector3d::Unit(i);
    j.col(i) = (direction_of(ball, d, highlight.at, camera) -
                direction_of(ball, -d, highlight.at, camera)) /
               (2.0 * kStep);
  }
  covariance += j * ball.covariance * j.transpose();
  for (int i = 0; i < 2; ++i) {
    const Vector2d d = kStep * Vector2d::Unit(i);
    const Vector3d column = (direction_of(ball, Vector3d::Zero(), highlight.at + d, camera) -
                             direction_of(ball, Vector3d::Zero(), highlight.at - d, camera)) /
                            (2.0 * kStep);
    covariance += highlight.sigma_px * highlight.sigma_px * column * column.transpose();
  }
  out.sigma_rad = std::sqrt(0.5 * covariance.trace());
  return out;
}

namespace {

using BallParameters = Eigen::Matrix<double, 5, 1>;  // highlight x, y; circle x, y, radius

/// A ball's spheres: as measured, and with each circle parameter perturbed up and down.
struct SphereSteps {
  MirrorSphere at;
  std::array<MirrorSphere, 6> moved;
  Vector3d depth_per_pixel = Vector3d::Zero();  ///< of the plane below it, by circle parameters
};
constexpr double kStep = 0.05;  // pixels

SphereSteps sphere_steps(const CameraModel& camera, const MeasuredBall& ball,
                         double radius_mm) {
  SphereSteps out;
  out.at = sphere_from_outline(camera, ball.outline, radius_mm);
  for (std::size_t i = 0; i < 6; ++i) {
    const Vector3d d =
        (i % 2 == 0 ? kStep : -kStep) * Vector3d::Unit(static_cast<Eigen::Index>(i / 2));
    out.moved[i] = sphere_from_outline(camera, moved_outline(ball, d), radius_mm);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    out.depth_per_pixel[static_cast<Eigen::Index>(i)] =
        (out.moved[2 * i].centre_mm.z() - out.moved[2 * i + 1].centre_mm.z()) / (2.0 * kStep);
  }
  return out;
}

/// One ball's ray and its perpendicular offset from a point, with derivatives.
struct RayMiss {
  Eigen::Matrix<double, 2, 3> across;  ///< two unit directions perpendicular to the ray
  Vector2d miss;
  Eigen::Matrix<double, 2, 5> per_parameter;
  Eigen::Matrix2d covariance;
};

Vector3d miss_of(const ReflectedRay& ray, const Vector3d& point) {
  const Vector3d d = point - ray.origin_mm;
  return d - ray.direction * ray.direction.dot(d);
}

RayMiss ray_miss(const CameraModel& camera, const SphereSteps& sphere, const MeasuredBall& ball,
                 const BallHighlight& highlight, const Vector3d& point) {
  const ReflectedRay ray = reflect_off(camera, sphere.at, highlight.at);
  RayMiss out;
  const Vector3d u = ray.direction.unitOrthogonal();
  out.across.row(0) = u.transpose();
  out.across.row(1) = ray.direction.cross(u).transpose();
  out.miss = out.across * miss_of(ray, point);
  const auto slope = [&](const ReflectedRay& up, const ReflectedRay& down) {
    return Vector2d(out.across * (miss_of(up, point) - miss_of(down, point)) / (2.0 * kStep));
  };
  for (int i = 0; i < 2; ++i) {
    const Vector2d d = kStep * Vector2d::Unit(i);
    out.per_parameter.col(i) = slope(reflect_off(camera, sphere.at, highlight.at + d),
                                     reflect_off(camera, sphere.at, highlight.at - d));
  }
  for (int i = 0; i < 3; ++i) {
    const std::size_t at = 2 * static_cast<std::size_t>(i);
    out.per_parameter.col(2 + i) =
        slope(reflect_off(camera, sphere.moved[at], highlight.at),
              reflect_off(camera, sphere.moved[at + 1], highlight.at));
  }
  Eigen::Matrix<double, 5, 5> own = Eigen::Matrix<double, 5, 5>::Zero();
  own.topLeftCorner<2, 2>().diagonal().setConstant(highlight.sigma_px * highlight.sigma_px);
  own.bottomRightCorner<3, 3>() = ball.covariance;
  out.covariance = out.per_parameter * own * out.per_parameter.transpose();
  return out;
}

}  // namespace

BallScene ball_scene(const CameraModel& camera, std::span<const MeasuredBall> balls,
                     std::span<const double> radii_mm) {
  HAARLIGHT_EXPECTS(!balls.empty() && radii_mm.size() == balls.size(),
                    "a radius for each ball");
  const CameraModel own = at_origin(camera);
  BallScene scene;
  for (std::size_t b = 0; b < balls.size(); ++b) {
    scene.spheres.push_back(sphere_from_outline(own, balls[b].outline, radii_mm[b]));
    scene.camera_mm +=
        (scene.spheres.back().centre_mm.z() + radii_mm[b]) / static_cast<double>(balls.size());
  }
  for (MirrorSphere& sphere : scene.spheres) {
    sphere.centre_mm = in_picture(sphere.centre_mm) + Vector3d(0, 0, scene.camera_mm);
  }
  return scene;
}

BallPositions ball_positions(
    const CameraModel& camera, std::span<const MeasuredBall> balls,
    std::span<const double> radii_mm,
    const std::vector<std::vector<std::optional<BallHighlight>>>& highlights) {
  const CameraModel own = at_origin(camera);
  const BallScene scene = ball_scene(camera, balls, radii_mm);
  const auto n_balls = balls.size();
  std::vector<SphereSteps> spheres;
  for (std::size_t b = 0; b < n_balls; ++b) {
    spheres.push_back(sphere_steps(own, balls[b], radii_mm[b]));
  }
  BallPositions out;
  out.n_balls = static_cast<int>(n_balls);
  for (const std::vector<std::optional<BallHighlight>>& of_light : highlights) {
    HAARLIGHT_EXPECTS(of_light.size() == n_balls, "a highlight, or none, for each ball");
    BallPosition light;
    std::vector<ReflectedRay> rays;
    std::vector<std::size_t> shown;
    for (std::size_t b = 0; b < n_balls; ++b) {
      if (of_light[b]) {
        rays.push_back(reflect_off(own, spheres[b].at, of_light[b]->at));
        shown.push_back(b);
      }
    }
    if (rays.size() < 2) {
      out.lights.push_back(light);
      continue;
    }
    light.position_mm = intersect(rays).position_mm;
    std::vector<RayMiss> misses;
    Matrix3d information = Matrix3d::Zero();
    constexpr int kRounds = 3;  // weights change little with the position
    for (int round = 0; round < kRounds; ++round) {
      misses.clear();
      information.setZero();
      Vector3d rhs = Vector3d::Zero();
      for (const std::size_t b : shown) {
        misses.push_back(ray_miss(own, spheres[b], balls[b], *of_light[b], light.position_mm));
        const RayMiss& m = misses.back();
        const Eigen::Matrix2d weight = m.covariance.inverse();
        information += m.across.transpose() * weight * m.across;
        rhs -= m.across.transpose() * weight * m.miss;
      }
      light.position_mm += information.ldlt().solve(rhs);
    }
    const Matrix3d known = information.inverse();
    light.freedom = 2 * static_cast<int>(shown.size()) - 3;
    // The reference plane of heights moves with every ball's own depth.
    std::vector<std::size_t> seen_at(n_balls, n_balls);
    for (std::size_t i = 0; i < shown.size(); ++i) {
      seen_at[shown[i]] = i;
    }
    for (std::size_t b = 0; b < n_balls; ++b) {
      Eigen::Matrix<double, 3, 5> slope = Eigen::Matrix<double, 3, 5>::Zero();
      Eigen::Matrix<double, 5, 5> of_ball = Eigen::Matrix<double, 5, 5>::Zero();
      of_ball.bottomRightCorner<3, 3>() = balls[b].covariance;
      if (seen_at[b] < n_balls) {
        const RayMiss& m = misses[seen_at[b]];
        slope = -known * m.across.transpose() * m.covariance.inverse() * m.per_parameter;
        of_ball.topLeftCorner<2, 2>().diagonal().setConstant(of_light[b]->sigma_px *
                                                             of_light[b]->sigma_px);
        light.chi2 += m.miss.dot(m.covariance.inverse() * m.miss);
      }
      slope.row(2).tail<3>() -=
          spheres[b].depth_per_pixel.transpose() / static_cast<double>(n_balls);
      light.covariance_mm2 += slope * of_ball * slope.transpose();
    }
    light.position_mm = in_picture(light.position_mm) + Vector3d(0, 0, scene.camera_mm);
    const Vector3d mirrored(1.0, -1.0, -1.0);
    light.covariance_mm2 = mirrored.asDiagonal() * light.covariance_mm2 * mirrored.asDiagonal();
    out.chi2 += light.chi2;
    out.freedom += light.freedom;
    out.lights.push_back(light);
  }
  return out;
}

bool BallPositions::is_model_wrong() const {
  if (freedom <= 0) {
    return false;
  }
  const double n = std::min(freedom, 3 * n_balls);
  // Wilson and Hilferty (1931).
  const double limit = std::pow(1.0 - 2.0 / (9.0 * n) + kMostZ * std::sqrt(2.0 / (9.0 * n)), 3);
  return chi2 / freedom > limit;
}

}  // namespace haarlight::relight
