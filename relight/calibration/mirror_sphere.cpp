// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/calibration/mirror_sphere.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr const char* kWhere = "mirror sphere";
constexpr double kParallel = 1e-9;

}  // namespace

std::vector<Eigen::Vector2d> outline_points(ImageView<const float> mask) {
  float most = 0.0F;
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      most = std::max(most, mask(y, x));
    }
  }
  const double level = 0.5 * static_cast<double>(most);
  std::vector<Eigen::Vector2d> points;
  const auto cross = [&](int x0, int y0, int x1, int y1) {
    const double a = static_cast<double>(mask(y0, x0)) - level;
    const double b = static_cast<double>(mask(y1, x1)) - level;
    if ((a > 0.0) != (b > 0.0)) {
      const double t = a / (a - b);
      points.emplace_back(x0 + 0.5 + t * (x1 - x0), y0 + 0.5 + t * (y1 - y0));
    }
  };
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      if (x + 1 < mask.width()) {
        cross(x, y, x + 1, y);
      }
      if (y + 1 < mask.height()) {
        cross(x, y, x, y + 1);
      }
    }
  }
  if (points.empty()) {
    throw Error("the mask has no outline", kWhere, "white on the ball, black around it");
  }
  return points;
}

PictureCircle fit_circle(std::span<const Eigen::Vector2d> points) {
  // x^2 + y^2 = 2 a x + 2 b y + c, about the mean for better conditioning.
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& p : points) {
    mean += p / static_cast<double>(points.size());
  }
  Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
  for (const Eigen::Vector2d& p : points) {
    const Eigen::Vector2d d = p - mean;
    const Eigen::Vector3d row(2.0 * d.x(), 2.0 * d.y(), 1.0);
    m += row * row.transpose();
    rhs += d.squaredNorm() * row;
  }
  const double spread = m.topLeftCorner<2, 2>().determinant();
  const double trace = m.topLeftCorner<2, 2>().trace();
  if (points.size() < 3 || !(spread > 1e-9 * trace * trace)) {
    throw Error("no circle goes through these points", kWhere,
                "give three or more of an outline");
  }
  const Eigen::Vector3d s = m.ldlt().solve(rhs);
  PictureCircle circle;
  circle.x = mean.x() + s[0];
  circle.y = mean.y() + s[1];
  circle.radius = std::sqrt(s[2] + s.head<2>().squaredNorm());
  double sum = 0.0;
  for (const Eigen::Vector2d& p : points) {
    const double miss = (p - Eigen::Vector2d(circle.x, circle.y)).norm() - circle.radius;
    sum += miss * miss / static_cast<double>(points.size());
  }
  circle.rms = std::sqrt(sum);
  return circle;
}

Eigen::Vector2d find_highlight(ImageView<const float> picture, const PictureCircle& ball,
                               const HighlightOptions& options) {
  const auto value = [&](int y, int x) {
    double sum = 0.0;
    for (int c = 0; c < picture.channels(); ++c) {
      sum += static_cast<double>(picture(y, x, c));
    }
    return sum;
  };
  const double limit = options.inside * ball.radius;
  const auto is_inside = [&](int y, int x) {
    return y >= 0 && x >= 0 && y < picture.height() && x < picture.width() &&
           std::hypot(x + 0.5 - ball.x, y + 0.5 - ball.y) <= limit;
  };
  const int y0 = std::max(0, static_cast<int>(ball.y - limit));
  const int y1 = std::min(picture.height() - 1, static_cast<int>(ball.y + limit));
  const int x0 = std::max(0, static_cast<int>(ball.x - limit));
  const int x1 = std::min(picture.width() - 1, static_cast<int>(ball.x + limit));
  double most = 0.0;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      if (!is_inside(y, x)) {
        continue;
      }
      if (!std::isfinite(value(y, x))) {
        throw Error(
            fmt::format("the picture is not finite at pixel ({}, {}), on the ball", x, y),
            kWhere, "take that picture again, or repair the pixel");
      }
      most = std::max(most, value(y, x));
    }
  }
  if (!(most > 0.0)) {
    throw Error("the ball is black", kWhere, "check the ball's circle and the exposure");
  }
  const double level = options.fraction * most;
  const int width = x1 - x0 + 1;
  std::vector<std::uint8_t> seen(static_cast<std::size_t>(width * (y1 - y0 + 1)), 0);
  struct Part {
    double weight = 0.0;
    Eigen::Vector2d at = Eigen::Vector2d::Zero();
    int n = 0;
  };
  Part best;
  std::vector<std::pair<int, int>> open;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      Part part;
      open.assign(1, {y, x});
      while (!open.empty()) {
        const auto [py, px] = open.back();
        open.pop_back();
        if (!is_inside(py, px) || py < y0 || py > y1 || px < x0 || px > x1) {
          continue;
        }
        std::uint8_t& mark = seen[static_cast<std::size_t>((py - y0) * width + px - x0)];
        if (mark != 0 || value(py, px) < level) {
          continue;
        }
        mark = 1;
        // A saturated highlight is flat: every pixel of it gets at least some weight.
        const double w = value(py, px) - level + 0.05 * most;
        part.weight += w;
        part.at += w * Eigen::Vector2d(px + 0.5, py + 0.5);
        ++part.n;
        for (int d = 0; d < 4; ++d) {
          open.emplace_back(py + (d == 0) - (d == 1), px + (d == 2) - (d == 3));
        }
      }
      if (part.weight > best.weight) {
        best = part;
      }
    }
  }
  const double area = std::numbers::pi * ball.radius * ball.radius;
  if (best.n > options.most_area * area) {
    throw Error(fmt::format("the brightest part fills {:.0f} % of the ball: not a highlight",
                            100.0 * best.n / area),
                kWhere, "darken the room, or use a mirror ball");
  }
  return best.at / best.weight;
}

Eigen::Vector3d mirror_direction(const PictureCircle& ball, const Eigen::Vector2d& highlight) {
  const double nx = (highlight.x() - ball.x) / ball.radius;
  const double ny = -(highlight.y() - ball.y) / ball.radius;
  const double r2 = nx * nx + ny * ny;
  if (!(r2 < 1.0)) {
    throw Error("the highlight lies outside the ball", kWhere, "check the ball's circle");
  }
  const double nz = std::sqrt(1.0 - r2);
  return {2.0 * nz * nx, 2.0 * nz * ny, 2.0 * nz * nz - 1.0};
}

MirrorSphere sphere_from_outline(const CameraModel& camera,
                                 std::span<const Eigen::Vector2d> outline, double radius_mm) {
  // On the cone about axis a with half angle alpha every unit ray has d.a = cos alpha.
  Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
  for (const Eigen::Vector2d& p : outline) {
    const Eigen::Vector3d d = ray_through(camera, p.x(), p.y()).direction_world;
    m += d * d.transpose();
    rhs += d;
  }
  const Eigen::LDLT<Eigen::Matrix3d> solver(m);
  const Eigen::Vector3d v = solver.solve(rhs);
  const double length = v.norm();
  if (outline.size() < 3 || !(length > 1.0) || !v.allFinite()) {
    throw Error("these points are no outline of a ball", kWhere,
                "give points all round the ball");
  }
  const double sin_alpha = std::sqrt(1.0 - 1.0 / (length * length));
  return {camera.centre_world() + radius_mm / sin_alpha / length * v, radius_mm};
}

ReflectedRay reflect_off(const CameraModel& camera, const MirrorSphere& sphere,
                         const Eigen::Vector2d& highlight) {
  const CameraRay ray = ray_through(camera, highlight.x(), highlight.y());
  const Eigen::Vector3d from = ray.origin_world - sphere.centre_mm;
  const double b = from.dot(ray.direction_world);
  const double root = b * b - from.squaredNorm() + sphere.radius_mm * sphere.radius_mm;
  if (!(root >= 0.0) || -b - std::sqrt(root) <= 0.0) {
    throw Error("the highlight does not lie on the ball", kWhere,
                "check the ball's position and radius");
  }
  ReflectedRay out;
  out.origin_mm = ray.origin_world + (-b - std::sqrt(root)) * ray.direction_world;
  const Eigen::Vector3d n = (out.origin_mm - sphere.centre_mm).normalized();
  out.direction = ray.direction_world - 2.0 * n.dot(ray.direction_world) * n;
  return out;
}

namespace {

/// The normal between two directions at which the reflection's angles are equal, by halving the
/// arc between them.
/// @param light, camera  from the ball's centre; not parallel
Eigen::Vector3d halve_arc(const Eigen::Vector3d& light, const Eigen::Vector3d& camera,
                          double radius) {
  const Eigen::Vector3d a = light.normalized();
  const Eigen::Vector3d b = camera.normalized();
  const Eigen::Vector3d across = (b - a.dot(b) * a).normalized();
  const auto normal = [&](double angle) {
    return Eigen::Vector3d(std::cos(angle) * a + std::sin(angle) * across);
  };
  double low = 0.0;
  double high = std::atan2(b.dot(across), b.dot(a));
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    const Eigen::Vector3d n = normal(middle);
    const bool is_nearer_light =
        (light - radius * n).normalized().dot(n) > (camera - radius * n).normalized().dot(n);
    (is_nearer_light ? low : high) = middle;
  }
  return normal(0.5 * (low + high));
}

}  // namespace

Eigen::Vector2d glint_of(const CameraModel& camera, const MirrorSphere& sphere,
                         const Eigen::Vector3d& light_mm) {
  // The normal there bisects the directions to light and camera.
  Eigen::Vector3d n = (light_mm - sphere.centre_mm).normalized() +
                      (camera.centre_world() - sphere.centre_mm).normalized();
  n.normalize();
  bool is_done = false;
  for (int i = 0; i < 200 && !is_done; ++i) {
    const Eigen::Vector3d at = sphere.centre_mm + sphere.radius_mm * n;
    const Eigen::Vector3d next =
        ((light_mm - at).normalized() + (camera.centre_world() - at).normalized()).normalized();
    is_done = (next - n).norm() < 1e-15;
    n = next;
  }
  if (!is_done) {  // closer than about half a radius the iteration does not converge
    n = halve_arc(light_mm - sphere.centre_mm, camera.centre_world() - sphere.centre_mm,
                  sphere.radius_mm);
  }
  const auto point = project(camera, sphere.centre_mm + sphere.radius_mm * n);
  HAARLIGHT_EXPECTS(point.has_value(), "a ball in front of the camera");
  return *point;
}

Triangulated intersect(std::span<const ReflectedRay> rays) {
  Eigen::Matrix3d m = Eigen::Matrix3d::Zero();
  Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
  for (const ReflectedRay& ray : rays) {
    const Eigen::Matrix3d across =
        Eigen::Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    m += across;
    rhs += across * ray.origin_mm;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(m);
  Triangulated out;
  out.conditioning = eigen.eigenvalues()[0] / std::max(eigen.eigenvalues()[2], 1e-300);
  if (rays.size() < 2 || !(out.conditioning > kParallel)) {
    throw Error("the rays do not meet: fewer than two, or parallel", kWhere,
                "use balls that stand further apart");
  }
  out.position_mm = m.ldlt().solve(rhs);
  double sum = 0.0;
  for (const ReflectedRay& ray : rays) {
    const Eigen::Vector3d d = out.position_mm - ray.origin_mm;
    sum += (d - ray.direction * ray.direction.dot(d)).squaredNorm();
  }
  out.rms_mm = std::sqrt(sum / static_cast<double>(rays.size()));
  return out;
}

}  // namespace haarlight::relight
