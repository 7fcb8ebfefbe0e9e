// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fresnel's equations and microfacets against formulas written another way; all BSDFs at extremes.

#include <array>
#include <cmath>
#include <complex>
#include <cstdint>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "render/bsdf/bsdf.h"
#include "render/bsdf/fresnel.h"
#include "render/scene/metals.h"
#include "tests/render/bsdf/hemisphere_rule.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;
using Long = long double;

double uniform(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(92, a, b)); }

/// By the angles: sin(i - t)/sin(i + t) and tan(i - t)/tan(i + t).
Long fresnel_by_angles(Long cosine, Long ior) {
  const Long i = std::acos(cosine);
  const Long t = std::asin(std::sin(i) / ior);
  const Long s = std::sin(i - t) / std::sin(i + t);
  const Long p = std::tan(i - t) / std::tan(i + t);
  return 0.5L * (s * s + p * p);
}

/// By complex numbers.
Long fresnel_by_complex(Long cosine, std::complex<Long> ior) {
  const std::complex<Long> refracted =
      std::sqrt(std::complex<Long>(1.0L) - (1.0L - cosine * cosine) / (ior * ior));
  const std::complex<Long> s = (cosine - ior * refracted) / (cosine + ior * refracted);
  const std::complex<Long> p = (ior * cosine - refracted) / (ior * cosine + refracted);
  return 0.5L * (std::norm(s) + std::norm(p));
}

TEST(Fresnel, DielectricsFollowTheAngles) {
  for (const double ior : {1.0001, 1.33, 1.5, 2.5, 4.0, 0.9, 1.0 / 1.5, 0.25}) {
    for (int i = 1; i < 200; ++i) {
      const double cosine = i / 200.0;
      if (std::sqrt(1.0 - cosine * cosine) >= 0.999999 * ior) {
        continue;
      }
      const auto truth = static_cast<double>(
          fresnel_by_angles(static_cast<Long>(cosine), static_cast<Long>(ior)));
      // A cosine near total reflection is the root of a difference of 1e-6: 1e-16 / 1e-6.
      EXPECT_NEAR(fresnel_dielectric(cosine, ior), truth, 1e-10 * truth + 1e-15)
          << ior << ' ' << cosine;
    }
  }
}

TEST(Fresnel, DielectricsAtTheirSpecialAngles) {
  for (const double ior : {1.1, 1.5, 4.0, 1.0 / 1.5, 0.25}) {
    const double normal = (ior - 1.0) / (ior + 1.0);
    EXPECT_NEAR(fresnel_dielectric(1.0, ior), normal * normal, 1e-15);
    // Brewster: tan = n, the parallel part is 0, the other one ((n^2 - 1)/(n^2 + 1))^2.
    const double other = (ior * ior - 1.0) / (ior * ior + 1.0);
    EXPECT_NEAR(fresnel_dielectric(1.0 / std::sqrt(1.0 + ior * ior), ior), 0.5 * other * other,
                1e-14);
    EXPECT_EQ(fresnel_dielectric(0.0, ior), 1.0);
    // The same from the other side, at the refracted angle.
    if (ior > 1.0) {
      for (const double cosine : {1.0, 0.5, 0.01}) {
        EXPECT_NEAR(fresnel_dielectric(refracted_cosine(cosine, ior), 1.0 / ior),
                    fresnel_dielectric(cosine, ior), 1e-10);
      }
    } else {
      EXPECT_EQ(fresnel_dielectric(0.999 * std::sqrt(1.0 - ior * ior), ior), 1.0);
      EXPECT_LT(fresnel_dielectric(1.001 * std::sqrt(1.0 - ior * ior), ior), 1.0);
    }
  }
  for (const double cosine : {1.0, 0.3, 1e-6, 1e-12}) {
    EXPECT_EQ(fresnel_dielectric(cosine, 1.0), 0.0);
  }
}

TEST(Fresnel, ConductorsFollowComplexNumbers) {
  for (const double eta : {0.01, 0.2, 1.0, 1.5, 6.0, 20.0}) {
    for (const double k : {0.0, 1e-6, 0.5, 3.6, 20.0}) {
      for (int i = 0; i <= 100; ++i) {
        const double cosine = i / 100.0;
        const auto truth = static_cast<double>(fresnel_by_complex(
            static_cast<Long>(cosine),
            std::complex<Long>(static_cast<Long>(eta), static_cast<Long>(k))));
        if (i == 0 || (k < 1e-3 && std::abs(eta * eta + cosine * cosine - 1.0) < 1e-3)) {
          continue;  // 0/0 in the formula that it is compared with; its total reflection
        }
        const double found =
            fresnel_conductor(cosine, Vector3d::Constant(eta), Vector3d::Constant(k)).y();
        EXPECT_NEAR(found, truth, 1e-11) << eta << ' ' << k << ' ' << cosine;
      }
    }
    const double f0 = ((eta - 1) * (eta - 1) + 9.0) / ((eta + 1) * (eta + 1) + 9.0);
    EXPECT_NEAR(fresnel_conductor(1.0, Vector3d::Constant(eta), Vector3d::Constant(3.0)).x(),
                f0, 1e-15);
  }
  // Without absorption: a dielectric.
  for (int i = 1; i <= 100; ++i) {
    EXPECT_NEAR(fresnel_conductor(i / 100.0, Vector3d::Constant(1.5), Vector3d::Zero()).x(),
                fresnel_dielectric(i / 100.0, 1.5), 1e-14);
  }
}

TEST(Metal, HasItsColour) {
  const auto reflected = [](Metal metal) {
    const ComplexIor ior = ior_of(metal);
    return fresnel_conductor(1.0, ior.eta, ior.k);
  };
  for (const Metal metal : {Metal::gold, Metal::copper}) {
    const Vector3d f = reflected(metal);
    EXPECT_GT(f.x(), f.y() + 0.1);
    EXPECT_GT(f.y(), f.z());
    EXPECT_GT(f.x(), 0.9);
  }
  EXPECT_GT(reflected(Metal::silver).minCoeff(), 0.95);
  const Vector3d aluminium = reflected(Metal::aluminium);
  EXPECT_GT(aluminium.minCoeff(), 0.88);
  EXPECT_LT(aluminium.maxCoeff(), 0.94);
}

/// [Walter07] and [Heitz14] by tangents.
double reflection_by_tangents(double alpha, const Vector3d& o, const Vector3d& i) {
  const Vector3d h = (o + i) / (o + i).norm();
  const double cos2 = h.z() * h.z();
  const double tan2 = (h.x() * h.x() + h.y() * h.y()) / cos2;
  const double e = 1.0 + tan2 / (alpha * alpha);
  const double d = 1.0 / (pi * alpha * alpha * cos2 * cos2 * e * e);
  const auto lambda = [&](const Vector3d& v) {
    const double t2 = (v.x() * v.x() + v.y() * v.y()) / (v.z() * v.z());
    return 0.5 * (std::sqrt(1.0 + alpha * alpha * t2) - 1.0);
  };
  return d / (4.0 * o.z() * i.z() * (1.0 + lambda(o) + lambda(i)));
}

TEST(Ggx, ReflectionIsThatOfThePapers) {
  for (const double alpha : {0.01, 0.1, 0.5, 1.0}) {
    for (std::uint64_t i = 0; i < 300; ++i) {
      const Vector3d a = direction(0.01 + 0.99 * uniform(i, 0), 2.0 * pi * uniform(i, 1));
      const Vector3d b = direction(0.01 + 0.99 * uniform(i, 2), 2.0 * pi * uniform(i, 3));
      const double truth = reflection_by_tangents(alpha, a, b);
      // 1/cos^4 of half vectors near the horizon.
      EXPECT_NEAR(Ggx{.alpha = alpha}.reflection(a, b), truth, 1e-10 * truth);
    }
  }
}

TEST(Ggx, TheNormalsCoverTheSurfaceOnce) {
  // Integral of D cos_h = 1, and of the visible ones, max(0, h.o) D G(o) / cos_o = 1.
  for (const double alpha : {0.15, 0.5, 1.0}) {
    const Ggx facets{.alpha = alpha};
    const double whole =
        integrate_over_hemisphere(direction(1.0, 0.0), [&](const Vector3d& half) {
          return Vector3d::Constant(facets.density_of_normals(half)).eval();
        }).x();
    EXPECT_NEAR(whole, 1.0, 1e-5) << alpha;  // of the quadrature at alpha = 0.15
  }
}

TEST(Ggx, ASmoothSurfaceReflectsByFresnel) {
  const Vector3d eta(0.16, 0.42, 1.38);
  const Vector3d k(3.60, 2.47, 1.92);
  const Conductor smooth{.facets = {.alpha = 1e-4}, .eta = eta, .k = k};
  for (const double cosine : {1.0, 0.7, 0.3, 0.1}) {
    const Vector3d to_eye = direction(cosine, 0.7);
    Vector3d sum = Vector3d::Zero();
    for (int i = 0; i < 64; ++i) {
      for (int j = 0; j < 64; ++j) {
        sum += smooth.sample(to_eye, 0.5, Vector2d((i + 0.5) / 64, (j + 0.5) / 64)).weight;
      }
    }
    // alpha^2 for the change of F over the lobe, times its tail: log(1/alpha^2).
    EXPECT_LE((sum / 4096 - fresnel_conductor(cosine, eta, k)).norm(), 1e-6) << cosine;
  }
}

// ---- extremes --------------------------------------------------------------------------------

bool is_finite(const Vector3d& v) { return v.allFinite() && v.minCoeff() >= 0.0; }

TEST(Bsdf, NoNumberIsLostAtExtremes) {
  std::vector<Bsdf> all = {Mirror{.reflectance = Vector3d::Zero()}, Mirror{}};
  for (const double rho : {0.0, 1.0}) {
    const Vector3d kd = Vector3d::Constant(rho);
    for (const double exponent : {0.0, 1.0, 1e5}) {
      all.emplace_back(BlinnPhong{.kd = kd, .ks = 1.0 - rho, .exponent = exponent});
    }
    for (const double sigma : {0.0, 1e-9, 0.5 * pi}) {
      all.emplace_back(OrenNayar::of(kd, sigma));
    }
    for (const double alpha : {1e-4, 1.0}) {
      for (const double ior : {1.2, 2.5}) {
        all.emplace_back(Coated{.kd = kd, .ior = ior, .facets = {.alpha = alpha}});
      }
    }
  }
  for (const double ior : {1.0, 4.0, 0.25}) {
    all.emplace_back(Dielectric{.ior = ior});
  }
  for (const double alpha : {1e-4, 1.0}) {
    for (const double eta : {0.0, 0.01, 1.0, 20.0}) {
      for (const double k : {0.0, 20.0}) {
        all.emplace_back(Conductor{.facets = {.alpha = alpha},
                                   .eta = Vector3d::Constant(eta),
                                   .k = Vector3d::Constant(k)});
      }
    }
  }
  const double last = 1.0 - 0x1p-53;
  std::vector<Vector3d> directions;
  for (const double cosine : {1.0, 0.5, 1e-4, 1e-12}) {
    for (const double phi : {0.0, 0.5, pi, 0.5 + pi}) {
      directions.push_back(direction(cosine, phi));
    }
  }
  for (std::size_t b = 0; b < all.size(); ++b) {
    const Bsdf& bsdf = all[b];
    for (const Vector3d& to_eye : directions) {
      EXPECT_TRUE(is_finite(albedo(bsdf, to_eye))) << b << ' ' << to_eye.z();
      for (const Vector3d& to_light : directions) {
        EXPECT_TRUE(is_finite(evaluate(bsdf, to_eye, to_light)))
            << b << ' ' << to_eye.z() << ' ' << to_light.z();
        const double per_sr = density(bsdf, to_eye, to_light);
        EXPECT_TRUE(std::isfinite(per_sr) && per_sr >= 0.0)
            << b << ' ' << to_eye.z() << ' ' << to_light.z();
      }
      for (const double lobe : {0.0, 0.5, last}) {
        for (const double x : {0.0, 0.3, 0.5, last}) {
          for (const double y : {0.0, 0.3, last}) {
            const BsdfSample drawn = sample(bsdf, to_eye, lobe, Vector2d(x, y));
            EXPECT_TRUE(std::isfinite(drawn.density) && drawn.density >= 0.0);
            EXPECT_TRUE(is_finite(drawn.weight)) << b << ' ' << to_eye.z() << ' ' << x;
            if (drawn.is_found) {
              EXPECT_NEAR(drawn.to_light.norm(), 1.0, 1e-12) << b << ' ' << to_eye.z();
            }
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render
