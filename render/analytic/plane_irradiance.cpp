// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/analytic/plane_irradiance.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"
#include "haarlight/render/analytic/polygon_light.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr int kMax = PlaneIrradiance::kMaxNodes;
constexpr double kLeastTolerance = 1e-13;

/// Gauss-Legendre on [-1, 1], weights of sum 1.
struct Rule {
  std::array<double, kMax> x{};
  std::array<double, kMax> w{};
};

/// Nodes by Newton's method on P_n.
Rule make_rule(int n) {
  Rule rule;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(std::numbers::pi * (i + 0.75) / (n + 0.5));
    double slope = 1.0;
    for (int step = 0; step < 50; ++step) {
      double p0 = 1.0;
      double p1 = x;
      for (int k = 2; k <= n; ++k) {
        p0 = std::exchange(p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k);
      }
      slope = n * (x * p1 - p0) / (x * x - 1.0);
      const double dx = p1 / slope;
      x -= dx;
      if (std::abs(dx) < 1e-16) {
        break;
      }
    }
    rule.x.at(static_cast<std::size_t>(i)) = x;
    rule.w.at(static_cast<std::size_t>(i)) = 1.0 / ((1.0 - x * x) * slope * slope);
  }
  return rule;
}

const std::array<Rule, kMax + 1>& rules() {
  static const std::array<Rule, kMax + 1> all = [] {
    std::array<Rule, kMax + 1> made;
    for (int n = 2; n <= kMax; ++n) {
      made.at(static_cast<std::size_t>(n)) = make_rule(n);
    }
    return made;
  }();
  return all;
}

/// r^2 and n.r at the light's point (s, t), s and t in -1 .. 1.
struct Field {
  double r2 = 0.0;  // of the centre
  double along_u = 0.0;
  double along_v = 0.0;
  double uu = 0.0;
  double vv = 0.0;
  double uv = 0.0;
  double n = 0.0;  // n.r of the centre
  double n_u = 0.0;
  double n_v = 0.0;
};

/// Mean of (n.r) g(r^2) over the rectangle by N x N Gauss points.
template <int N, class G>
double mean_over(const Field& f, const Rule& rule, const G& g) {
  double sum = 0.0;
  for (std::size_t i = 0; i < N; ++i) {
    const double s = rule.x[i];
    const double r2_s = f.r2 + s * (2.0 * f.along_u + s * f.uu);
    const double v_s = 2.0 * (f.along_v + s * f.uv);
    const double n_s = f.n + s * f.n_u;
    double inner = 0.0;
    for (std::size_t j = 0; j < N; ++j) {
      const double t = rule.x[j];
      inner += rule.w[j] * (n_s + t * f.n_v) * g(r2_s + t * (v_s + t * f.vv));
    }
    sum += rule.w[i] * inner;
  }
  return sum;
}

template <class G>
double mean_over(int n, const Field& f, const G& g) {
  const Rule& rule = rules().at(static_cast<std::size_t>(n));
  switch (n) {
    case 2:
      return mean_over<2>(f, rule, g);
    case 3:
      return mean_over<3>(f, rule, g);
    case 4:
      return mean_over<4>(f, rule, g);
    case 5:
      return mean_over<5>(f, rule, g);
    case 6:
      return mean_over<6>(f, rule, g);
    case 7:
      return mean_over<7>(f, rule, g);
    default:
      return mean_over<8>(f, rule, g);
  }
}

/// The smallest distance at which n Gauss points per axis suffice: by bisection, since
/// rule_error falls with distance.
std::array<double, kMax + 1> reaches(double radius, double mu, double slant, double tolerance) {
  std::array<double, kMax + 1> all{};
  for (int n = 2; n <= kMax; ++n) {
    double low = radius;
    double high = 1e6 * radius;
    for (int i = 0; i < 60 && radius > 0.0; ++i) {
      const double middle = std::sqrt(low * high);
      (PlaneIrradiance::rule_error(n, radius, middle, mu, slant) > tolerance ? low : high) =
          middle;
    }
    all.at(static_cast<std::size_t>(n)) = high;
  }
  return all;
}

}  // namespace

/// Along one axis, of half length a <= radius, g = h^mu r^-(3 + mu) is analytic where r^2 is
/// not 0: at least distance / a half-lengths away. Its series falls as that of (1 - z)^-(4 +
/// mu), z = a / (2 distance). n Gauss points are exact up to degree 2 n - 1; times n.r, which
/// is linear and changes by at most `slant` of its mean, the remainder starts with the terms 2
/// n of g and `slant` times 2 n - 1. A factor of four for two axes and both ends.
double PlaneIrradiance::rule_error(int n, double radius, double distance, double mu,
                                   double slant) {
  const double z = radius / (2.0 * distance);
  if (!(z < 0.5)) {
    return std::numeric_limits<double>::infinity();
  }
  double before = 1.0;
  double term = 1.0;  // of z^k: (4 + mu) (5 + mu) ... (3 + mu + k) / k!
  for (int k = 1; k <= 2 * n; ++k) {
    before = std::exchange(term, term * (3.0 + mu + k) / k * z);
  }
  // Each later term falls by at least the factor (4 + mu + 2 n) / (2 n + 1) z.
  const double ratio = (4.0 + mu + 2 * n) / (2 * n + 1.0) * z;
  return ratio < 1.0 ? 4.0 * (term + slant * before) / (1.0 - ratio)
                     : std::numeric_limits<double>::infinity();
}

PlaneIrradiance::PlaneIrradiance(std::span<const SquareLight> lights, const Vector3d& normal,
                                 double d, double tolerance)
    : normal_(normal) {
  HAARLIGHT_EXPECTS(tolerance >= kLeastTolerance, "an error that doubles can reach");
  for (const SquareLight& square : lights) {
    Light light;
    light.square = square;
    light.half_u = 0.5 * square.width_mm * square.u;
    light.half_v = 0.5 * square.height_mm * square.v;
    light.uv = light.half_u.dot(light.half_v);
    light.scale = 4.0 * square.radiance * light.half_u.cross(light.half_v).norm();
    light.is_whole = true;
    const double height = normal.dot(square.centre) + d;
    HAARLIGHT_EXPECTS(std::isfinite(height), "finite positions of the lights");
    light.slant = height > 0.0 ? std::min(1.0, (std::abs(normal.dot(light.half_u)) +
                                                std::abs(normal.dot(light.half_v))) /
                                                   height)
                               : 1.0;
    for (const Vector3d& corner : light_corners(square)) {
      light.radius = std::max(light.radius, (corner - square.centre).norm());
      light.is_whole = light.is_whole && normal.dot(corner) + d >= 0.0;
    }
    const bool is_as_before = !lights_.empty() && lights_.back().radius == light.radius &&
                              lights_.back().slant == light.slant &&
                              lights_.back().square.lobe_mu == square.lobe_mu;
    light.reach = is_as_before ? lights_.back().reach
                               : reaches(light.radius, square.lobe_mu, light.slant, tolerance);
    lights_.push_back(light);
  }
}

double PlaneIrradiance::irradiance(const Light& light, const Vector3d& point) const {
  const Vector3d way = light.square.centre - point;
  const double h = -light.square.emits.dot(way);
  if (!(h > 0.0)) {
    return 0.0;
  }
  const double r2 = way.squaredNorm();
  const double nearest = std::sqrt(r2) - light.radius;
  int n = 2;
  while (n <= kMaxNodes && nearest < light.reach[static_cast<std::size_t>(n)]) {
    ++n;
  }
  if (n > kMaxNodes || !light.is_whole) {
    return light_irradiance(light.square, point, normal_);
  }
  const Field f{r2,
                way.dot(light.half_u),
                way.dot(light.half_v),
                light.half_u.squaredNorm(),
                light.half_v.squaredNorm(),
                light.uv,
                normal_.dot(way),
                normal_.dot(light.half_u),
                normal_.dot(light.half_v)};
  const double mu = light.square.lobe_mu;
  if (mu == 1.0) {  // (n.r)/r h/r 1/r^2
    return light.scale * h * mean_over(n, f, [](double q) { return 1.0 / (q * q); });
  }
  const double h2 = h * h;
  return light.scale * mean_over(n, f, [h2, mu](double q) {
           return std::pow(h2 / q, 0.5 * mu) / (q * std::sqrt(q));
         });
}

void PlaneIrradiance::evaluate(const Vector3d& point, std::span<double> out) const {
  HAARLIGHT_EXPECTS(out.size() == lights_.size(), "room for every light");
  for (std::size_t k = 0; k < lights_.size(); ++k) {
    out[k] = irradiance(lights_[k], point);
  }
}

}  // namespace haarlight::render
