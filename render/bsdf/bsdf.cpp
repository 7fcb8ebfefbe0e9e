// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/bsdf.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

double lobe_scale(const Bsdf& bsdf) { return bsdf.ks * (bsdf.exponent + 8.0) / (8.0 * pi); }

/// The fraction of samples that the glossy lobe gets: by what the two parts reflect, roughly.
double glossy_fraction(const Bsdf& bsdf) {
  const double diffuse = bsdf.kd.mean();
  return bsdf.ks > 0.0 ? bsdf.ks / (bsdf.ks + diffuse) : 0.0;
}

/// cos(theta) of a half vector h drawn from (n + 1)/(2 pi) cos^n.
Vector3d half_vector(double exponent, const Vector2d& square) {
  const double cos_h = std::pow(1.0 - square.x(), 1.0 / (exponent + 1.0));
  const double sin_h = std::sqrt(std::max(0.0, 1.0 - cos_h * cos_h));
  const double phi = 2.0 * pi * square.y();
  return {sin_h * std::cos(phi), sin_h * std::sin(phi), cos_h};
}

Vector3d cosine_direction(const Vector2d& square) {
  const double r = std::sqrt(square.x());
  const double phi = 2.0 * pi * square.y();
  return {r * std::cos(phi), r * std::sin(phi), std::sqrt(std::max(0.0, 1.0 - square.x()))};
}

}  // namespace

Bsdf bsdf_of(const Material& material) {
  return {.kd = material.kd, .ks = material.ks, .exponent = material.exponent};
}

bool is_black(const Bsdf& bsdf) { return bsdf.kd.isZero(0.0) && bsdf.ks == 0.0; }

Vector3d evaluate(const Bsdf& bsdf, const Vector3d& to_eye, const Vector3d& to_light) {
  if (!(to_eye.z() > 0.0 && to_light.z() > 0.0)) {
    return Vector3d::Zero();
  }
  Vector3d f = bsdf.kd * std::numbers::inv_pi;
  if (bsdf.ks > 0.0) {
    const Vector3d half = (to_eye + to_light).normalized();
    f.array() += lobe_scale(bsdf) * std::pow(half.z(), bsdf.exponent);
  }
  return f;
}

double density(const Bsdf& bsdf, const Vector3d& to_eye, const Vector3d& to_light) {
  if (!(to_eye.z() > 0.0 && to_light.z() > 0.0)) {
    return 0.0;
  }
  const double glossy = glossy_fraction(bsdf);
  double sum = (1.0 - glossy) * to_light.z() * std::numbers::inv_pi;
  if (glossy > 0.0) {
    // Of half vectors, and a half vector turns half as far as the direction: 1/(4 h.eye).
    const Vector3d half = (to_eye + to_light).normalized();
    const double towards = half.dot(to_eye);
    if (towards > 0.0) {
      sum += glossy * (bsdf.exponent + 1.0) / (2.0 * pi) * std::pow(half.z(), bsdf.exponent) /
             (4.0 * towards);
    }
  }
  return sum;
}

BsdfSample sample(const Bsdf& bsdf, const Vector3d& to_eye, double lobe,
                  const Vector2d& square) {
  BsdfSample drawn;
  if (!(to_eye.z() > 0.0) || is_black(bsdf)) {
    return drawn;
  }
  if (lobe < glossy_fraction(bsdf)) {
    const Vector3d half = half_vector(bsdf.exponent, square);
    drawn.to_light = 2.0 * half.dot(to_eye) * half - to_eye;
  } else {
    drawn.to_light = cosine_direction(square);
  }
  if (!(drawn.to_light.z() > 0.0)) {
    return drawn;
  }
  drawn.f = evaluate(bsdf, to_eye, drawn.to_light);
  drawn.density = density(bsdf, to_eye, drawn.to_light);
  return drawn;
}

}  // namespace haarlight::render
