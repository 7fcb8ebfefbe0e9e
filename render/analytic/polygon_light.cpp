// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/analytic/polygon_light.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Geometry>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;
using Polygon = std::vector<Vector3d>;

constexpr double kEps = std::numeric_limits<double>::epsilon();

struct GaussRule {
  int n = 0;
  std::array<double, 8> x{};  ///< nodes on [0, 1]
  std::array<double, 8> w{};  ///< weights, sum 1
};

/// Gauss-Legendre on [0, 1], nodes by Newton's method on P_n.
GaussRule make_gauss(int n) {
  GaussRule rule;
  rule.n = n;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(3.14159265358979323846 * (i + 0.75) / (n + 0.5));
    double derivative = 1.0;
    for (int step = 0; step < 50; ++step) {
      double p0 = 1.0;
      double p1 = x;
      for (int k = 2; k <= n; ++k) {
        const double p2 = ((2 * k - 1) * x * p1 - (k - 1) * p0) / k;
        p0 = p1;
        p1 = p2;
      }
      derivative = n * (x * p1 - p0) / (x * x - 1.0);
      const double dx = p1 / derivative;
      x -= dx;
      if (std::abs(dx) < 1e-16) {
        break;
      }
    }
    const auto s = static_cast<std::size_t>(i);
    rule.x.at(s) = 0.5 * (x + 1.0);
    rule.w.at(s) = 1.0 / ((1.0 - x * x) * derivative * derivative);
  }
  return rule;
}

const GaussRule& gauss(int n) {
  static const GaussRule four = make_gauss(4);
  static const GaussRule six = make_gauss(6);
  static const GaussRule eight = make_gauss(8);
  return n == 4 ? four : n == 6 ? six : eight;
}

/// The integrand over the emitter: cos(theta) (h / r)^mu / r^2, where h is the receiver's
/// distance from the emitter's plane. Vectors from the receiver.
struct Kernel {
  Vector3d normal;
  double h = 0.0;
  double mu = 1.0;

  [[nodiscard]] double operator()(const Vector3d& r) const {
    const double r2 = r.squaredNorm();
    const double distance = std::sqrt(r2);
    const double cos_l = h / distance;
    const double lobe = mu == 1.0 ? cos_l : std::pow(cos_l, mu);
    return std::max(0.0, normal.dot(r)) * lobe / (r2 * distance);
  }
};

/// Tensor Gauss on the quadrilateral p(s, t), bilinear in its corners; a triangle is one with
/// c == d (Duffy's map). The Jacobian is that of the planar bilinear map.
double integrate_patch(const Kernel& f, const std::array<Vector3d, 4>& q,
                       const GaussRule& rule) {
  double sum = 0.0;
  const Vector3d along_s0 = q[1] - q[0];
  const Vector3d along_s1 = q[2] - q[3];
  const Vector3d along_t0 = q[3] - q[0];
  const Vector3d along_t1 = q[2] - q[1];
  for (std::size_t i = 0; i < static_cast<std::size_t>(rule.n); ++i) {
    for (std::size_t j = 0; j < static_cast<std::size_t>(rule.n); ++j) {
      const double s = rule.x.at(i);
      const double t = rule.x.at(j);
      const Vector3d ds = (1.0 - t) * along_s0 + t * along_s1;
      const Vector3d dt = (1.0 - s) * along_t0 + s * along_t1;
      const Vector3d r = q[0] + s * along_s0 + t * dt;
      sum += rule.w.at(i) * rule.w.at(j) * ds.cross(dt).norm() * f(r);
    }
  }
  return sum;
}

struct PatchShape {
  double radius = 0.0;    ///< half the longest diagonal
  double distance = 0.0;  ///< at least the receiver's distance from the patch
};

double distance_to_segment(const Vector3d& a, const Vector3d& b) {
  const Vector3d ab = b - a;
  const double length2 = ab.squaredNorm();
  const double t = length2 > 0.0 ? std::clamp(-a.dot(ab) / length2, 0.0, 1.0) : 0.0;
  return (a + t * ab).norm();
}

PatchShape shape_of(const std::array<Vector3d, 4>& q) {
  const Vector3d centre = 0.25 * (q[0] + q[1] + q[2] + q[3]);
  PatchShape shape;
  for (const Vector3d& corner : q) {
    shape.radius = std::max(shape.radius, (corner - centre).norm());
  }
  shape.distance = std::max(centre.norm() - shape.radius, 0.0);
  return shape;
}

/// Nodes per axis that leave a relative error of 1e-13; 0 if the patch is too near and must be
/// split. The limits are those of the worst patch, a line that points at the receiver, of
/// integrand r^-(3 + mu) times a linear n.r, found in 40 digits for mu from 1 to 64: they grow
/// linearly with mu.
int nodes_for(const PatchShape& shape, double mu) {
  const double ratio = shape.distance / shape.radius / (1.0 + std::max(0.0, mu - 1.0) / 6.5);
  if (ratio > 68.0) {
    return 4;
  }
  if (ratio > 12.0) {
    return 6;
  }
  return ratio > 4.7 ? 8 : 0;
}

void integrate_adaptive(const Kernel& f, const std::array<Vector3d, 4>& q, int depth,
                        Irradiance& sum) {
  const PatchShape shape = shape_of(q);
  const int n = shape.radius > 0.0 ? nodes_for(shape, f.mu) : 4;
  constexpr int kMaxDepth = 90;  // sides of 2^-45 of the light's
  if (n > 0) {
    const double value = integrate_patch(f, q, gauss(n));
    sum.value += value;
    sum.error += 1e-13 * value;
    return;
  }
  if (depth == kMaxDepth) {  // the receiver lies in the light
    const double value = integrate_patch(f, q, gauss(8));
    sum.value += value;
    sum.error += value;
    return;
  }
  // Split the longer side in two: 4:1 strips stay rare.
  const double side_s = std::max((q[1] - q[0]).norm(), (q[2] - q[3]).norm());
  const double side_t = std::max((q[3] - q[0]).norm(), (q[2] - q[1]).norm());
  if (side_s >= side_t) {
    const Vector3d low = 0.5 * (q[0] + q[1]);
    const Vector3d high = 0.5 * (q[3] + q[2]);
    integrate_adaptive(f, {q[0], low, high, q[3]}, depth + 1, sum);
    integrate_adaptive(f, {low, q[1], q[2], high}, depth + 1, sum);
  } else {
    const Vector3d left = 0.5 * (q[0] + q[3]);
    const Vector3d right = 0.5 * (q[1] + q[2]);
    integrate_adaptive(f, {q[0], q[1], right, left}, depth + 1, sum);
    integrate_adaptive(f, {left, right, q[2], q[3]}, depth + 1, sum);
  }
}

/// The part of a convex polygon with n.r >= 0 (one pass of Sutherland and Hodgman's clipping).
Polygon clip_to_horizon(const Polygon& polygon, const Vector3d& n) {
  Polygon kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3d& a = polygon[i];
    const Vector3d& b = polygon[(i + 1) % polygon.size()];
    const double da = n.dot(a);
    const double db = n.dot(b);
    if (da >= 0.0) {
      kept.push_back(a);
    }
    if ((da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0)) {
      kept.emplace_back(a + (b - a) * (da / (da - db)));
    }
  }
  return kept;
}

Irradiance quadrature(const Polygon& polygon, const Kernel& kernel) {
  Irradiance sum;
  if (polygon.size() == 4) {
    // A parallelogram or any convex quadrilateral: one bilinear patch.
    integrate_adaptive(kernel, {polygon[0], polygon[1], polygon[2], polygon[3]}, 0, sum);
    return sum;
  }
  for (std::size_t i = 1; i + 1 < polygon.size(); ++i) {
    integrate_adaptive(kernel, {polygon[0], polygon[i], polygon[i + 1], polygon[i + 1]}, 0,
                       sum);
  }
  return sum;
}

/// E = 1/2 sum_i theta_i n.g_i, theta_i the angle between successive vertices seen from the
/// receiver and g_i the unit normal of the plane through both and the receiver.
Irradiance lambert_sum(const Polygon& polygon, const Vector3d& n) {
  double sum = 0.0;
  double magnitude = 0.0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3d& a = polygon[i];
    const Vector3d& b = polygon[(i + 1) % polygon.size()];
    const Vector3d edge_normal = a.cross(b);
    const double sine = edge_normal.norm();
    if (sine == 0.0) {
      continue;
    }
    const double theta = std::atan2(sine, a.dot(b));
    sum += 0.5 * theta * n.dot(edge_normal) / sine;
    magnitude += 0.5 * theta * (a.norm() * b.norm() / sine);
  }
  return {std::abs(sum), 4.0 * kEps * magnitude};
}

/// The receiver's distance from the polygon's plane (Newell's normal).
double distance_to_plane(const Polygon& polygon) {
  Vector3d area = Vector3d::Zero();
  for (std::size_t i = 1; i + 1 < polygon.size(); ++i) {
    area += (polygon[i] - polygon[0]).cross(polygon[i + 1] - polygon[0]);
  }
  const double norm = area.norm();
  return norm > 0.0 ? std::abs(area.dot(polygon[0])) / norm : 0.0;
}

/// @param polygon  from the receiver, already clipped
Irradiance irradiance_of(const Polygon& polygon, const Kernel& kernel) {
  if (polygon.size() < 3 || kernel.h == 0.0) {
    return {};
  }
  Irradiance closed{0.0, std::numeric_limits<double>::infinity()};
  if (kernel.mu == 1.0) {
    double nearest = std::numeric_limits<double>::infinity();
    double longest = 0.0;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Vector3d& b = polygon[(i + 1) % polygon.size()];
      nearest = std::min(nearest, distance_to_segment(polygon[i], b));
      longest = std::max(longest, (b - polygon[i]).norm());
    }
    if (longest > 0.25 * nearest) {  // below, quadrature needs one patch and is more accurate
      closed = lambert_sum(polygon, kernel.normal);
      if (closed.error <= 1e-12 * closed.value) {
        return closed;
      }
    }
  }
  const Irradiance sampled = quadrature(polygon, kernel);
  return sampled.error <= closed.error ? sampled : closed;
}

}  // namespace

Irradiance polygon_irradiance(std::span<const Vector3d> vertices, const Vector3d& point,
                              const Vector3d& normal) {
  HAARLIGHT_EXPECTS(vertices.size() >= 3, "a polygon of three vertices or more");
  Polygon polygon;
  for (const Vector3d& vertex : vertices) {
    polygon.emplace_back(vertex - point);
  }
  const Kernel kernel{normal, distance_to_plane(polygon), 1.0};
  return irradiance_of(clip_to_horizon(polygon, normal), kernel);
}

std::array<Vector3d, 4> light_corners(const SquareLight& light) {
  const Vector3d u = 0.5 * light.width_mm * light.u;
  const Vector3d v = 0.5 * light.height_mm * light.v;
  return {light.centre - u - v, light.centre + u - v, light.centre + u + v,
          light.centre - u + v};
}

Irradiance light_irradiance_with_error(const SquareLight& light, const Vector3d& point,
                                       const Vector3d& normal) {
  // The emitter is flat: the receiver is on the same side of all its points.
  const double h = light.emits.dot(point - light.centre);
  HAARLIGHT_EXPECTS(std::isfinite(h), "finite positions of light and point");
  if (!(h > 0.0)) {
    return {};
  }
  const Kernel kernel{normal, h, light.lobe_mu};
  std::array<Vector3d, 4> corners = light_corners(light);
  double lowest = std::numeric_limits<double>::infinity();
  for (Vector3d& corner : corners) {
    corner -= point;
    lowest = std::min(lowest, normal.dot(corner));
  }
  Irradiance result;
  const PatchShape shape = shape_of(corners);
  const int n_nodes = lowest >= 0.0 && shape.radius > 0.0 ? nodes_for(shape, kernel.mu) : 0;
  if (n_nodes > 0) {  // the usual case, without allocation
    result.value = integrate_patch(kernel, corners, gauss(n_nodes));
    result.error = 1e-13 * result.value;
  } else {
    const Polygon polygon(corners.begin(), corners.end());
    result = irradiance_of(clip_to_horizon(polygon, normal), kernel);
  }
  result.value *= light.radiance;
  result.error *= light.radiance;
  return result;
}

double light_irradiance(const SquareLight& light, const Vector3d& point,
                        const Vector3d& normal) {
  return light_irradiance_with_error(light, point, normal).value;
}

}  // namespace haarlight::render
