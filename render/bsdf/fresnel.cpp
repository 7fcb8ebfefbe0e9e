// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/fresnel.h"

#include <algorithm>
#include <cmath>

namespace haarlight::render {

namespace {

/// One colour. With (a + i b)^2 = (eta + i k)^2 - sin^2:
///
///   R_s = ((cos - a)^2 + b^2) / ((cos + a)^2 + b^2)
///   R_p = R_s ((a - sin tan)^2 + b^2) / ((a + sin tan)^2 + b^2)
///
/// the second multiplied by cos^2, so that grazing rays need no tangent.
double fresnel_conductor(double cosine, double eta, double k) {
  const double cos2 = cosine * cosine;
  const double sin2 = 1.0 - cos2;
  const double real = (eta - 1.0) * (eta + 1.0) - k * k + cos2;
  const double length = std::hypot(real, 2.0 * eta * k);
  // The root with the larger part first: the other one follows without a difference.
  const double larger = std::sqrt(0.5 * (length + std::abs(real)));
  const double smaller = larger > 0.0 ? eta * k / larger : 0.0;
  const double a = real > 0.0 ? larger : smaller;
  const double b = real > 0.0 ? smaller : larger;
  const double b2 = b * b;
  const double sum = (cosine + a) * (cosine + a) + b2;
  // 0/0 only where all are 0: grazing light on no boundary at all.
  const double r_s = sum > 0.0 ? ((cosine - a) * (cosine - a) + b2) / sum : 1.0;
  const double b2_cos2 = b2 * cos2;
  const double minus = a * cosine - sin2;
  const double plus = a * cosine + sin2;
  const double denominator = plus * plus + b2_cos2;
  const double ratio = denominator > 0.0 ? (minus * minus + b2_cos2) / denominator : 1.0;
  return 0.5 * r_s * (1.0 + ratio);
}

}  // namespace

double refracted_cosine(double cosine, double ior) {
  // 1 - sin^2/ior^2, where cos is known: exactly cos for ior = 1.
  return std::sqrt(std::max(0.0, cosine * cosine + (ior - 1.0) * (ior + 1.0))) / ior;
}

double fresnel_dielectric(double cosine, double ior) {
  const double refracted = refracted_cosine(cosine, ior);
  if (!(refracted > 0.0)) {
    return 1.0;
  }
  const double s = (cosine - ior * refracted) / (cosine + ior * refracted);
  const double p = (ior * cosine - refracted) / (ior * cosine + refracted);
  return 0.5 * (s * s + p * p);
}

Eigen::Vector3d fresnel_conductor(double cosine, const Eigen::Vector3d& eta,
                                  const Eigen::Vector3d& k) {
  return {fresnel_conductor(cosine, eta.x(), k.x()), fresnel_conductor(cosine, eta.y(), k.y()),
          fresnel_conductor(cosine, eta.z(), k.z())};
}

}  // namespace haarlight::render
