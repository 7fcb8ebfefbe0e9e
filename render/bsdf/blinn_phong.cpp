// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/blinn_phong.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

double lobe_scale(const BlinnPhong& bsdf) {
  return bsdf.ks * (bsdf.exponent + 8.0) / (8.0 * pi);
}

/// The fraction of samples that the glossy lobe gets: by what the two parts reflect, roughly.
double glossy_fraction(const BlinnPhong& bsdf) {
  return bsdf.ks > 0.0 ? bsdf.ks / (bsdf.ks + bsdf.kd.mean()) : 0.0;
}

/// A half vector h drawn from (n + 1)/(2 pi) cos^n.
Vector3d half_vector(double exponent, const Vector2d& square) {
  const double cos_h = std::pow(1.0 - square.x(), 1.0 / (exponent + 1.0));
  const double sin_h = std::sqrt(std::max(0.0, 1.0 - cos_h * cos_h));
  const Vector2d around = at_turns(square.y());
  return {sin_h * around.x(), sin_h * around.y(), cos_h};
}

}  // namespace

Vector3d BlinnPhong::evaluate(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return Vector3d::Zero();
  }
  Vector3d f = kd * std::numbers::inv_pi;
  if (ks > 0.0) {
    const Vector3d half = (to_eye + to_light).normalized();
    f.array() += lobe_scale(*this) * std::pow(half.z(), exponent);
  }
  return f;
}

Vector3d BlinnPhong::glossy(const Vector3d& to_eye, const Vector3d& to_light) const {
  return BlinnPhong{.ks = ks, .exponent = exponent}.evaluate(to_eye, to_light);
}

double BlinnPhong::density(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return 0.0;
  }
  const double glossy = glossy_fraction(*this);
  double sum = (1.0 - glossy) * to_light.z() * std::numbers::inv_pi;
  if (glossy > 0.0) {
    // Of half vectors, and a half vector turns half as far as the direction: 1/(4 h.eye).
    const Vector3d half = (to_eye + to_light).normalized();
    const double towards = half.dot(to_eye);
    if (towards > 0.0) {
      sum += glossy * (exponent + 1.0) / (2.0 * pi) * std::pow(half.z(), exponent) /
             (4.0 * towards);
    }
  }
  return sum;
}

BsdfSample BlinnPhong::sample(const Vector3d& to_eye, double lobe,
                              const Vector2d& square) const {
  BsdfSample drawn;
  if (!(to_eye.z() > 0.0) || is_black()) {
    return drawn;
  }
  if (lobe < glossy_fraction(*this)) {
    const Vector3d half = half_vector(exponent, square);
    drawn.to_light = 2.0 * half.dot(to_eye) * half - to_eye;
  } else {
    drawn.to_light = cosine_direction(square);
  }
  if (!(drawn.to_light.z() > 0.0)) {
    return drawn;
  }
  drawn.density = density(to_eye, drawn.to_light);
  drawn.is_found = drawn.density > 0.0;
  if (drawn.is_found) {
    drawn.weight = evaluate(to_eye, drawn.to_light) * (drawn.to_light.z() / drawn.density);
  }
  return drawn;
}

Vector3d BlinnPhong::albedo(const Vector3d& /*to_eye*/) const {
  return (kd.array() + ks).min(1.0);
}

}  // namespace haarlight::render
