// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include <Eigen/Core>

#include "render/bsdf/bsdf.h"

/// @file
/// Integrals over directions, for tests of BSDFs.

namespace haarlight::render {

/// Unit vector. @param cosine  with the normal
inline Eigen::Vector3d direction(double cosine, double phi) {
  const double sine = std::sqrt((1.0 - cosine) * (1.0 + cosine));
  return {sine * std::cos(phi), sine * std::sin(phi), cosine};
}

/// Gauss and Legendre's rule.
class GaussRule {
 public:
  explicit GaussRule(int n) {
    using std::numbers::pi;
    for (int i = 0; i < n; ++i) {
      // Newton's method on the Legendre polynomial, from the roots' asymptotic positions.
      double x = std::cos(pi * (i + 0.75) / (n + 0.5));
      double slope = 0.0;
      for (int step = 0; step < 20; ++step) {
        double p = 1.0;
        double before = 0.0;
        for (int k = 1; k <= n; ++k) {
          const double next = ((2 * k - 1) * x * p - (k - 1) * before) / k;
          before = p;
          p = next;
        }
        slope = n * (x * p - before) / (x * x - 1.0);
        x -= p / slope;
      }
      points_.push_back(x);
      weights_.push_back(2.0 / ((1.0 - x * x) * slope * slope));
    }
  }

  /// Calls f(point, weight).
  template <class Function>
  void integrate(double low, double high, const Function& f) const {
    for (std::size_t i = 0; i < points_.size(); ++i) {
      f(0.5 * (low + high) + 0.5 * (high - low) * points_[i], 0.5 * (high - low) * weights_[i]);
    }
  }

 private:
  std::vector<double> points_;
  std::vector<double> weights_;
};

/// Integral of f(to_light) cos over the hemisphere: Gauss points in panels of cos and phi that are
/// narrow towards the horizon, the mirrored azimuth and the normal. Edges are where f may have a
/// kink: the eye's cosine, and right angles to its azimuth.
template <class Function>
Eigen::Vector3d integrate_over_hemisphere(const Eigen::Vector3d& to_eye, const Function& f) {
  static const GaussRule rule(10);
  constexpr double kPi = std::numbers::pi;
  std::vector<double> cosines = {0.0,  1e-6, 1e-5, 1e-4, 4e-4,  1.6e-3, 6e-3,      0.02,
                                 0.05, 0.1,  0.2,  0.3,  0.4,   0.5,    0.6,       0.7,
                                 0.8,  0.9,  0.95, 0.99, 0.999, 1.0,    to_eye.z()};
  std::sort(cosines.begin(), cosines.end());
  constexpr std::array kTurns = {0.0, 0.06, 0.15, 0.3, 0.6, 1.0, 0.5 * kPi, 2.2, kPi};
  const double mirrored = std::atan2(to_eye.y(), to_eye.x()) + kPi;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t c = 0; c + 1 < cosines.size(); ++c) {
    rule.integrate(cosines[c], cosines[c + 1], [&](double cosine, double w) {
      for (const double side : {-1.0, 1.0}) {
        for (std::size_t p = 0; p + 1 < kTurns.size(); ++p) {
          rule.integrate(kTurns.at(p), kTurns.at(p + 1), [&](double turn, double v) {
            sum += (w * v * cosine) * f(direction(cosine, mirrored + side * turn));
          });
        }
      }
    });
  }
  return sum;
}

/// Directional-hemispherical reflectance, without delta lobes.
inline Eigen::Vector3d reflectance(const Bsdf& bsdf, const Eigen::Vector3d& to_eye) {
  return integrate_over_hemisphere(to_eye, [&](const Eigen::Vector3d& to_light) {
    return evaluate(bsdf, to_eye, to_light);
  });
}

}  // namespace haarlight::render
