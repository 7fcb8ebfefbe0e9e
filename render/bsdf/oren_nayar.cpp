// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/oren_nayar.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::inv_pi;

// f = f_1 + f_m, single and multiple scattering [Portsmouth25]:
//
//   f_1 = rho/pi A (1 + r s/t),  A = 1/(1 + c r),  c = 1/2 - 2/(3 pi)
//   s = i.o - cos_i cos_o;  t = max(cos_i, cos_o) where s > 0, else 1
//
// Its reflectance for rho = 1 is E(o) = A (1 + r g(o)), and averaged over cos_o dw/pi it is
// <E> = A (1 + r m), m = 2/3 - 28/(15 pi). With the multiple albedo rho_m = rho^2 <E> / (1 - rho (1 -
// <E>)),
//
//   f_m = rho_m/pi (1 - E(o)) (1 - E(i)) / (1 - <E>),
//
// where 1 - E = A r (c - g) and 1 - <E> = A r (c - m): written so, r = 0 needs no case of its own.
constexpr double kC = 0.5 - 2.0 / 3.0 * inv_pi;
constexpr double kM = 2.0 / 3.0 - 28.0 / 15.0 * inv_pi;

/// g = [sin (theta - sin cos - 2/3) + 2/3 tan (1 - sin^3)] / pi, from 0 to c. The tangent's pole
/// cancels: tan (1 - sin^3) = sin cos (1 + sin + sin^2) / (1 + sin).
double single_gain(const Vector3d& direction) {
  const double cos = std::min(1.0, direction.z());
  const double sin = std::hypot(direction.x(), direction.y());
  const double theta = std::atan2(sin, cos);
  return inv_pi * (sin * (theta - sin * cos - 2.0 / 3.0) +
                   2.0 / 3.0 * sin * cos * (1.0 + sin + sin * sin) / (1.0 + sin));
}

double scale_of(double roughness) { return 1.0 / (1.0 + kC * roughness); }

/// rho_m of each colour.
Vector3d multiple_albedo(const OrenNayar& bsdf) {
  const double mean = scale_of(bsdf.roughness) * (1.0 + bsdf.roughness * kM);
  return bsdf.kd.array().square() * mean / (1.0 - bsdf.kd.array() * (1.0 - mean));
}

}  // namespace

OrenNayar OrenNayar::of(const Vector3d& kd, double sigma) {
  const double sigma2 = sigma * sigma;
  const double a = 1.0 - 0.5 * sigma2 / (sigma2 + 0.33);
  const double b = 0.45 * sigma2 / (sigma2 + 0.09);
  return {.kd = kd, .roughness = b / a};
}

Vector3d OrenNayar::evaluate(const Vector3d& to_eye, const Vector3d& to_light) const {
  if (!are_above(to_eye, to_light)) {
    return Vector3d::Zero();
  }
  const double scale = scale_of(roughness);
  const double s = to_eye.x() * to_light.x() + to_eye.y() * to_light.y();
  const double t = s > 0.0 ? std::max(to_eye.z(), to_light.z()) : 1.0;
  const Vector3d single = kd * (scale * (1.0 + roughness * s / t));
  const double missing =
      scale * roughness * (kC - single_gain(to_eye)) * (kC - single_gain(to_light)) / (kC - kM);
  return inv_pi * (single + multiple_albedo(*this) * std::max(0.0, missing));
}

double OrenNayar::density(const Vector3d& to_eye, const Vector3d& to_light) const {
  return are_above(to_eye, to_light) ? to_light.z() * inv_pi : 0.0;
}

BsdfSample OrenNayar::sample(const Vector3d& to_eye, double /*lobe*/,
                             const Vector2d& square) const {
  BsdfSample drawn;
  drawn.to_light = cosine_direction(square);
  drawn.density = density(to_eye, drawn.to_light);
  drawn.is_found = drawn.density > 0.0 && !is_black();
  if (drawn.is_found) {
    drawn.weight = std::numbers::pi * evaluate(to_eye, drawn.to_light);
  }
  return drawn;
}

Vector3d OrenNayar::albedo(const Vector3d& to_eye) const {
  const double scale = scale_of(roughness);
  const double gain = single_gain(to_eye);
  return kd * (scale * (1.0 + roughness * gain)) +
         multiple_albedo(*this) * (scale * roughness * (kC - gain));
}

}  // namespace haarlight::render
