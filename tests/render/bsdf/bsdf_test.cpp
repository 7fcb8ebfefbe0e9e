// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/bsdf.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "render/bsdf/coat_albedo.h"
#include "render/bsdf/fresnel.h"
#include "tests/render/bsdf/hemisphere_rule.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

double uniform(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(91, a, b)); }

const Vector3d kGrey = Vector3d::Ones();
constexpr double kDegree = pi / 180.0;

struct Named {
  std::string name;
  Bsdf bsdf;
};

Conductor metal(double alpha, const Vector3d& eta, const Vector3d& k) {
  return {.facets = {.alpha = alpha}, .eta = eta, .k = k};
}
/// Reflects all light: eta = 0 has a Fresnel reflectance of exactly 1.
Conductor lossless(double alpha) { return metal(alpha, 0.0 * kGrey, kGrey); }
Conductor gold(double alpha) {
  return metal(alpha, Vector3d(0.16, 0.42, 1.38), Vector3d(3.60, 2.47, 1.92));
}
Coated coated(const Vector3d& kd, double ior, double alpha) {
  return {.kd = kd, .ior = ior, .facets = {.alpha = alpha}};
}

/// Every kind with a smooth lobe, wide enough for tables of directions.
const std::vector<Named> kSmooth = {
    {"lambert", Lambert{.kd = Vector3d(0.8, 0.5, 0.2)}},
    {"blinn_phong 1", BlinnPhong{.kd = 0.4 * kGrey, .ks = 0.3, .exponent = 1.0}},
    {"blinn_phong 40", BlinnPhong{.kd = 0.2 * kGrey, .ks = 0.5, .exponent = 40.0}},
    {"oren_nayar 30", OrenNayar::of(Vector3d(0.9, 0.5, 0.1), 30.0 * kDegree)},
    {"oren_nayar 90", OrenNayar::of(kGrey, 90.0 * kDegree)},
    {"conductor 0.1", gold(0.1)},
    {"conductor 0.4", gold(0.4)},
    {"conductor 1", lossless(1.0)},
    {"coated 0.1", coated(Vector3d(0.7, 0.2, 0.05), 1.5, 0.1)},
    {"coated 0.5", coated(0.9 * kGrey, 1.33, 0.5)},
    {"coat alone", coated(0.0 * kGrey, 2.0, 0.3)},
};
/// Lobes that are narrower.
const std::vector<Named> kNarrow = {
    {"blinn_phong 400", BlinnPhong{.ks = 0.7, .exponent = 400.0}},
    {"conductor 0.01", gold(0.01)},
    {"conductor 1e-4", lossless(1e-4)},
    {"coated 0.01", coated(0.5 * kGrey, 1.5, 0.01)},
};

std::vector<Named> all_smooth() {
  std::vector<Named> all = kSmooth;
  all.insert(all.end(), kNarrow.begin(), kNarrow.end());
  return all;
}

TEST(Bsdf, IsReciprocal) {
  for (const auto& [name, bsdf] : all_smooth()) {
    for (std::uint64_t i = 0; i < 500; ++i) {
      // A fourth of the directions graze.
      const double low = i % 4 == 0 ? 1e-4 : 1.0;
      const Vector3d a = direction(low * uniform(i, 0), 2.0 * pi * uniform(i, 1));
      const Vector3d b = direction(uniform(i, 2), 2.0 * pi * uniform(i, 3));
      const Vector3d there = evaluate(bsdf, a, b);
      // A dozen roundings; those of h.o are as large where it is near 0.
      EXPECT_LE((there - evaluate(bsdf, b, a)).norm(), 1e-12 * there.norm()) << name;
    }
  }
}

TEST(Bsdf, NothingPassesThroughOpaqueOnes) {
  for (const auto& [name, bsdf] : all_smooth()) {
    EXPECT_TRUE(evaluate(bsdf, direction(0.5, 1.0), -direction(0.5, 2.0)).isZero(0.0)) << name;
    EXPECT_TRUE(evaluate(bsdf, -direction(0.5, 1.0), direction(0.5, 2.0)).isZero(0.0)) << name;
    EXPECT_EQ(density(bsdf, direction(0.5, 1.0), -direction(0.5, 2.0)), 0.0) << name;
    EXPECT_FALSE(sample(bsdf, -direction(0.5, 1.0), 0.5, Vector2d(0.5, 0.5)).is_found) << name;
  }
}

TEST(Bsdf, BlackOnesAndDeltaLobesAreTold) {
  for (const Bsdf& black : {Bsdf(BlinnPhong{}), Bsdf(OrenNayar{.roughness = 0.5}),
                            Bsdf(Mirror{.reflectance = Vector3d::Zero()})}) {
    EXPECT_TRUE(is_black(black));
    EXPECT_FALSE(has_smooth_part(black));
    EXPECT_FALSE(sample(black, direction(0.5, 1.0), 0.5, Vector2d(0.5, 0.5)).is_found);
  }
  for (const Bsdf& specular : {Bsdf(Mirror{}), Bsdf(Dielectric{})}) {
    EXPECT_FALSE(is_black(specular));
    EXPECT_FALSE(has_smooth_part(specular));
    EXPECT_TRUE(evaluate(specular, direction(0.5, 1.0), direction(0.5, 1.0 + pi)).isZero(0.0));
    EXPECT_EQ(density(specular, direction(0.5, 1.0), direction(0.5, 1.0 + pi)), 0.0);
    EXPECT_TRUE(sample(specular, direction(0.5, 1.0), 0.5, Vector2d(0.5, 0.5)).is_delta);
  }
  for (const auto& [name, bsdf] : all_smooth()) {
    EXPECT_FALSE(is_black(bsdf)) << name;
    EXPECT_TRUE(has_smooth_part(bsdf)) << name;
  }
}

TEST(Bsdf, IsThatOfTheMaterialAndTheSide) {
  Scene scene;
  scene.materials = {{.name = "matte", .kd = 0.3 * kGrey, .ks = 0.2, .exponent = 7.0},
                     {.name = "plaster", .bsdf = BsdfKind::oren_nayar, .sigma = 0.4},
                     {.name = "mirror", .bsdf = BsdfKind::mirror, .reflectance = 0.9 * kGrey},
                     {.name = "glass", .bsdf = BsdfKind::dielectric, .ior = 1.6},
                     {.name = "metal",
                      .bsdf = BsdfKind::conductor,
                      .roughness = 0.2,
                      .eta = 0.2 * kGrey,
                      .k = 3.0 * kGrey},
                     {.name = "lacquer", .bsdf = BsdfKind::coated, .ior = 1.4}};
  const auto of = [&](int material, bool is_front) {
    Hit hit;
    hit.material = material;
    hit.is_front = is_front;
    return bsdf_of(scene, hit);
  };
  EXPECT_EQ(std::get<BlinnPhong>(of(0, true)).exponent, 7.0);
  EXPECT_GT(std::get<OrenNayar>(of(1, false)).roughness, 0.0);
  EXPECT_EQ(std::get<Mirror>(of(2, false)).reflectance.x(), 0.9);
  EXPECT_EQ(std::get<Dielectric>(of(3, true)).ior, 1.6);
  EXPECT_EQ(std::get<Dielectric>(of(3, false)).ior, 1.0 / 1.6);
  EXPECT_EQ(std::get<Conductor>(of(4, true)).facets.alpha, 0.2);
  EXPECT_EQ(std::get<Coated>(of(5, false)).ior, 1.4);
}

/// Tables of directions against the integral of the density over their cells.
constexpr std::array kTableCosines = {1.0, 0.7, 0.2, 0.05};
constexpr double kFamilyError = 0.01;  // of all tables together, by Bonferroni

struct Table {
  static constexpr int kRows = 40;  // of theta, over both hemispheres
  static constexpr int kColumns = 40;
  static constexpr int kSamples = 100000;

  std::vector<double> counted = std::vector<double>(std::size_t{kRows} * kColumns, 0.0);
  std::vector<double> expected = counted;

  static std::size_t cell_of(const Vector3d& d) {
    const double theta = std::atan2(std::hypot(d.x(), d.y()), d.z());
    const double phi = std::atan2(d.y(), d.x()) + pi;
    const int row = std::min(kRows - 1, static_cast<int>(theta / pi * kRows));
    const int column = std::min(kColumns - 1, static_cast<int>(phi / (2.0 * pi) * kColumns));
    return static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column);
  }

  Table(const Bsdf& bsdf, const Vector3d& to_eye, std::uint64_t key) {
    for (std::uint64_t i = 0; i < kSamples; ++i) {
      const std::uint64_t at = hash_key(key, i);
      const BsdfSample drawn =
          sample(bsdf, to_eye, uniform(at, 4), Vector2d(uniform(at, 5), uniform(at, 6)));
      if (drawn.is_found) {
        counted[cell_of(drawn.to_light)] += 1.0;
      }
    }
    for (int row = 0; row < kRows; ++row) {
      for (int column = 0; column < kColumns; ++column) {
        expected[static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column)] =
            kSamples * integral(bsdf, to_eye, row, column);
      }
    }
  }

  /// Of the density over a cell. Near the mirrored azimuth, where lobes of grazing light are narrow,
  /// the cell is cut in 8.
  static double integral(const Bsdf& bsdf, const Vector3d& to_eye, int row, int column) {
    static const GaussRule rule(6);
    const double middle = 2.0 * pi * (column + 0.5) / kColumns - pi;
    const double off = std::cos(middle - std::atan2(to_eye.y(), to_eye.x()));
    const int n_parts = off < -0.9 ? 8 : 1;
    double sum = 0.0;
    for (int part = 0; part < n_parts; ++part) {
      const double low = 2.0 * pi * (column + static_cast<double>(part) / n_parts) / kColumns;
      rule.integrate(pi * row / kRows, pi * (row + 1) / kRows, [&](double theta, double w) {
        rule.integrate(low - pi, low - pi + 2.0 * pi / kColumns / n_parts,
                       [&](double phi, double v) {
                         const Vector3d d(std::sin(theta) * std::cos(phi),
                                          std::sin(theta) * std::sin(phi), std::cos(theta));
                         sum += w * v * std::sin(theta) * density(bsdf, to_eye, d);
                       });
      });
    }
    return sum;
  }

  /// Probability of a chi squared as large: Pearson's, by Wilson and Hilferty's cube root. Cells
  /// that expect less than 10 are one cell, with the samples that found no direction.
  [[nodiscard]] double p_value() const {
    double chi2 = 0.0;
    double cells = 0.0;
    double rest_expected = kSamples;
    double rest_counted = kSamples;
    for (std::size_t i = 0; i < expected.size(); ++i) {
      if (expected[i] >= 10.0) {
        chi2 += (counted[i] - expected[i]) * (counted[i] - expected[i]) / expected[i];
        cells += 1.0;
        rest_expected -= expected[i];
        rest_counted -= counted[i];
      }
    }
    if (rest_expected >= 10.0) {
      chi2 += (rest_counted - rest_expected) * (rest_counted - rest_expected) / rest_expected;
    } else {
      cells -= 1.0;
      if (rest_expected < -10.0 || std::abs(rest_counted - rest_expected) > 40.0) {
        return 0.0;
      }
    }
    const double spread = 2.0 / (9.0 * cells);
    const double z = (std::cbrt(chi2 / cells) - (1.0 - spread)) / std::sqrt(spread);
    return 0.5 * std::erfc(z / std::numbers::sqrt2);
  }
};

TEST(Bsdf, SamplesFollowTheirDensity) {
  const double least =
      kFamilyError / static_cast<double>(kSmooth.size() * kTableCosines.size());
  double smallest = 1.0;
  std::uint64_t key = 0;
  for (const auto& [name, bsdf] : kSmooth) {
    for (const double cosine : kTableCosines) {
      const Table table(bsdf, direction(cosine, 0.7), ++key);
      const double p = table.p_value();
      EXPECT_GE(p, least) << name << ' ' << cosine;
      smallest = std::min(smallest, p);
      double below = 0.0;
      for (std::size_t i = table.counted.size() / 2; i < table.counted.size(); ++i) {
        below += table.counted[i] + table.expected[i];
      }
      EXPECT_EQ(below, 0.0) << name << ' ' << cosine;
    }
  }
  RecordProperty("smallest p", std::to_string(smallest));
}

TEST(Bsdf, TheWeightIsWhatIsReflectedOverTheDensity) {
  for (const auto& [name, bsdf] : all_smooth()) {
    int n_found = 0;
    for (std::uint64_t i = 0; i < 2000; ++i) {
      const double cosine = i % 4 == 0 ? 1e-6 + 1e-3 * uniform(i, 10) : uniform(i, 10);
      const Vector3d to_eye = direction(cosine, 2.0 * pi * uniform(i, 11));
      const BsdfSample drawn =
          sample(bsdf, to_eye, uniform(i, 12), Vector2d(uniform(i, 13), uniform(i, 14)));
      if (!drawn.is_found) {
        continue;
      }
      ++n_found;
      EXPECT_FALSE(drawn.is_delta || drawn.is_transmission);
      EXPECT_EQ(drawn.radiance_scale, 1.0);
      EXPECT_NEAR(drawn.to_light.norm(), 1.0, 1e-14) << name;
      EXPECT_EQ(drawn.density, density(bsdf, to_eye, drawn.to_light)) << name;
      const Vector3d expected =
          evaluate(bsdf, to_eye, drawn.to_light) * (drawn.to_light.z() / drawn.density);
      EXPECT_LE((drawn.weight - expected).norm(), 1e-12 * expected.norm())
          << name << ' ' << cosine << ' ' << drawn.to_light.z();
    }
    EXPECT_GT(n_found, 500) << name;
  }
}

/// Reflectance by the mean of the weights, evenly over the numbers that are sampled with. That they
/// follow the density, and that the weight is right, is tested above.
Vector3d mean_weight(const Bsdf& bsdf, const Vector3d& to_eye, int n) {
  Vector3d sum = Vector3d::Zero();
  for (int k = 0; k < n; ++k) {
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        sum +=
            sample(bsdf, to_eye, (k + 0.5) / n, Vector2d((i + 0.5) / n, (j + 0.5) / n)).weight;
      }
    }
  }
  return sum / (static_cast<double>(n) * n * n);
}

constexpr std::array kFurnaceCosines = {1.0, 0.9, 0.5, 0.2, 0.05, 0.01, 1e-3, 1e-4};
// Of the quadrature, on smooth lobes of width 0.2 and more: it changes by less with twice the
// points.
constexpr double kQuadrature = 1e-6;

TEST(Bsdf, AWhiteLambertianAndOrenNayarReflectAllLight) {
  for (const double sigma_deg : {0.0, 1.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0}) {
    const OrenNayar bsdf = OrenNayar::of(kGrey, sigma_deg * kDegree);
    for (const double cosine : kFurnaceCosines) {
      const Vector3d to_eye = direction(cosine, 0.7);
      const Vector3d reflected = reflectance(bsdf, to_eye);
      EXPECT_NEAR(reflected.x(), 1.0, kQuadrature) << sigma_deg << ' ' << cosine;
      EXPECT_NEAR(albedo(bsdf, to_eye).x(), 1.0, 1e-14) << sigma_deg << ' ' << cosine;
    }
  }
  for (const double cosine : kFurnaceCosines) {
    EXPECT_NEAR(reflectance(BlinnPhong{.kd = kGrey}, direction(cosine, 0.7)).x(), 1.0,
                kQuadrature);
  }
}

TEST(Bsdf, NoFacetsReflectMoreThanTheyReceive) {
  for (const double alpha : {0.2, 0.35, 0.5, 0.7, 1.0}) {
    for (const double cosine : kFurnaceCosines) {
      const double reflected = reflectance(lossless(alpha), direction(cosine, 0.7)).x();
      EXPECT_LE(reflected, 1.0 + kQuadrature) << alpha << ' ' << cosine;
    }
  }
  for (const double alpha : {1e-4, 0.01, 0.05, 0.1}) {
    for (const double cosine : kFurnaceCosines) {
      EXPECT_LE(mean_weight(lossless(alpha), direction(cosine, 0.7), 24).x(), 1.0 + 1e-12)
          << alpha << ' ' << cosine;
    }
  }
}

TEST(Bsdf, FacetsLoseWhatTheDocumentSays) {
  // alpha = 1, seen from above: the integral of c/(1 + c) over c = cos of the light's direction.
  EXPECT_NEAR(reflectance(lossless(1.0), direction(1.0, 0.7)).x(), 1.0 - std::numbers::ln2,
              1e-6);
  // docs/numerics/surface.md, to its last digit.
  const struct {
    double alpha;
    std::array<double, 4> reflected;  // cos = 1, 0.5, 0.2, 0.1
  } rows[] = {{0.2, {0.948, 0.895, 0.858, 0.891}},
              {0.5, {0.688, 0.698, 0.790, 0.860}},
              {1.0, {0.307, 0.451, 0.642, 0.760}}};
  for (const auto& row : rows) {
    const std::array<double, 4> cosines = {1.0, 0.5, 0.2, 0.1};
    for (std::size_t i = 0; i < cosines.size(); ++i) {
      EXPECT_NEAR(reflectance(lossless(row.alpha), direction(cosines.at(i), 0.7)).x(),
                  row.reflected.at(i), 6e-4)
          << row.alpha << ' ' << cosines.at(i);
    }
  }
}

TEST(Bsdf, AWhiteCoatedBaseLosesLittleAndGainsNothing) {
  double lowest = 1.0;
  for (const double ior : {1.2, 1.5, 2.5}) {
    for (const double alpha : {1e-4, 0.05, 0.4, 1.0}) {
      const Coated white = coated(kGrey, ior, alpha);
      const Coated black = coated(0.0 * kGrey, ior, alpha);
      for (const double cosine : {1.0, 0.5, 0.05, 1e-3, 1e-4}) {
        const Vector3d to_eye = direction(cosine, 0.7);
        // The coat's lobe may be narrow: over visible normals. The rest is smooth.
        const double base = integrate_over_hemisphere(to_eye, [&](const Vector3d& to_light) {
                              return Vector3d(white.evaluate(to_eye, to_light) -
                                              black.evaluate(to_eye, to_light));
                            }).x();
        const double reflected =
            base + coat_reflectance_by_quadrature(cosine, alpha, ior, 48, 96);
        EXPECT_LE(reflected, 1.0 + kQuadrature) << ior << ' ' << alpha << ' ' << cosine;
        lowest = std::min(lowest, reflected);
        EXPECT_NEAR(white.albedo(to_eye).x(), reflected, 0.03);
      }
    }
  }
  // The table is at most 0.03 above the truth, its mean 0.4 %.
  EXPECT_GE(lowest, 0.966);
  RecordProperty("lowest", std::to_string(lowest));
}

TEST(Coated, WithASmoothCoatItIsTheClosedForm) {
  // [Saunderson42]: F + rho T <T> / (n^2 (1 - rho R)), R = 1 - <T>/n^2, as a sum over reflections
  // between base and coat. The table is up to 3 % of F above it here.
  for (const double ior : {1.33, 1.5, 1.9}) {
    long double mean = 0.0L;
    constexpr int kPoints = 4000;
    for (int j = 0; j < kPoints; ++j) {
      const double cosine = (j + 0.5) / kPoints;
      mean += 2.0L * static_cast<long double>(cosine) / kPoints *
              (1.0L - static_cast<long double>(fresnel_dielectric(cosine, ior)));
    }
    const auto through = static_cast<double>(mean);
    for (const double rho : {0.1, 0.5, 0.9}) {
      double base = 0.0;
      double leaving = rho * through / (ior * ior);
      for (int bounce = 0; bounce < 300; ++bounce) {
        base += leaving;
        leaving *= rho * (1.0 - through / (ior * ior));
      }
      for (const double cosine : {1.0, 0.7, 0.3}) {
        const double f = fresnel_dielectric(cosine, ior);
        EXPECT_NEAR(coated(rho * kGrey, ior, 1e-4).albedo(direction(cosine, 0.7)).x(),
                    f + (1.0 - f) * base, 0.03 * f + 0.004 * base)
            << ior << ' ' << rho << ' ' << cosine;
      }
    }
  }
}

TEST(Bsdf, QuadratureAndWeightsReflectTheSame) {
  for (const auto& [name, bsdf] : kSmooth) {
    for (const double cosine : {0.9, 0.3}) {
      const Vector3d to_eye = direction(cosine, 0.7);
      const Vector3d expected = reflectance(bsdf, to_eye);
      // Lobes are chosen in steps of 1/40, half of that is their error, times what the weights of
      // two lobes differ by: less than 1.
      EXPECT_LE((mean_weight(bsdf, to_eye, 40) - expected).cwiseAbs().maxCoeff(), 1.0 / 80.0)
          << name << ' ' << cosine;
    }
  }
}

TEST(Bsdf, TheAlbedoIsAFraction) {
  for (const auto& [name, bsdf] : all_smooth()) {
    for (const double cosine : kFurnaceCosines) {
      const Vector3d fraction = albedo(bsdf, direction(cosine, 0.7));
      EXPECT_GE(fraction.minCoeff(), 0.0) << name;
      EXPECT_LE(fraction.maxCoeff(), 1.0 + 1e-12) << name;
    }
  }
  // Closed forms against quadrature.
  const OrenNayar plaster = OrenNayar::of(Vector3d(0.9, 0.5, 0.1), 0.5);
  for (const double cosine : kFurnaceCosines) {
    EXPECT_LE(
        (albedo(plaster, direction(cosine, 0.7)) - reflectance(plaster, direction(cosine, 0.7)))
            .norm(),
        kQuadrature);
  }
  EXPECT_EQ(albedo(Bsdf(Mirror{.reflectance = 0.7 * kGrey}), direction(0.4, 0.0)).y(), 0.7);
  EXPECT_EQ(albedo(Bsdf(Dielectric{}), direction(0.4, 0.0)).y(), 1.0);
}

// ---- each kind -------------------------------------------------------------------------------

TEST(BlinnPhong, ALambertianReflectsItsAlbedo) {
  const Bsdf bsdf = kSmooth[0].bsdf;
  const Vector3d to_eye = direction(0.4, 0.3);
  for (std::uint64_t i = 0; i < 100; ++i) {
    const BsdfSample drawn =
        sample(bsdf, to_eye, uniform(i, 7), Vector2d(uniform(i, 8), uniform(i, 9)));
    EXPECT_LE((drawn.weight - Vector3d(0.8, 0.5, 0.2)).norm(), 1e-12);
  }
}

TEST(OrenNayar, WithoutSlopesItIsLambert) {
  const OrenNayar flat = OrenNayar::of(Vector3d(0.8, 0.5, 0.2), 0.0);
  const BlinnPhong lambert{.kd = Vector3d(0.8, 0.5, 0.2)};
  for (std::uint64_t i = 0; i < 100; ++i) {
    const Vector3d a = direction(uniform(i, 0), 2.0 * pi * uniform(i, 1));
    const Vector3d b = direction(uniform(i, 2), 2.0 * pi * uniform(i, 3));
    EXPECT_LE((flat.evaluate(a, b) - lambert.evaluate(a, b)).norm(), 1e-16);
  }
}

TEST(OrenNayar, HasTheShapeOfThePaper) {
  // A dark one scatters once: f pi / kd = A (1 + r s/t), r = B/A of the paper for 30 degrees.
  const double s2 = pi * pi / 36.0;
  const double r = (0.45 * s2 / (s2 + 0.09)) / (1.0 - 0.5 * s2 / (s2 + 0.33));
  const double a = 1.0 / (1.0 + (0.5 - 2.0 / (3.0 * pi)) * r);
  const OrenNayar dark = OrenNayar::of(1e-9 * kGrey, pi / 6.0);
  const auto scaled = [&](const Vector3d& o, const Vector3d& i) {
    return dark.evaluate(o, i).x() * pi * 1e9;
  };
  // The multiple scattering is 1e-9 of it.
  EXPECT_NEAR(scaled(direction(0.6, 0.0), direction(0.6, 0.0)), a * (1.0 + r * 0.64 / 0.6),
              1e-8);  // back to the eye
  EXPECT_NEAR(scaled(direction(0.6, 0.0), direction(0.8, 0.0)), a * (1.0 + r * 0.48 / 0.8),
              1e-8);  // same azimuth
  EXPECT_NEAR(scaled(direction(0.6, 0.0), direction(0.6, pi)), a * (1.0 - r * 0.64), 1e-8);
  EXPECT_NEAR(scaled(direction(0.6, 0.0), direction(0.3, 0.5 * pi)), a, 1e-8);
}

TEST(Mirror, ReflectsAtTheNormal) {
  const Bsdf mirror = Mirror{.reflectance = Vector3d(0.9, 0.8, 0.7)};
  const Vector3d to_eye = direction(0.3, 1.1);
  const BsdfSample drawn = sample(mirror, to_eye, 0.9, Vector2d(0.1, 0.2));
  EXPECT_TRUE(drawn.is_found && drawn.is_delta && !drawn.is_transmission);
  EXPECT_EQ(drawn.to_light, Vector3d(-to_eye.x(), -to_eye.y(), to_eye.z()));
  EXPECT_EQ(drawn.weight, Vector3d(0.9, 0.8, 0.7));
  EXPECT_EQ(drawn.density, 0.0);
  EXPECT_EQ(drawn.radiance_scale, 1.0);
}

TEST(Dielectric, OfIndexOneLetsAllLightStraightThrough) {
  for (std::uint64_t i = 0; i < 1000; ++i) {
    const double cosine = i % 2 == 0 ? uniform(i, 0) : 1e-12 + 1e-6 * uniform(i, 0);
    const Vector3d to_eye = direction(cosine, 2.0 * pi * uniform(i, 1));
    const BsdfSample drawn = sample(Dielectric{.ior = 1.0}, to_eye,
                                    i == 0 ? 0.0 : uniform(i, 2), Vector2d(0.1, 0.2));
    EXPECT_TRUE(drawn.is_found && drawn.is_delta && drawn.is_transmission);
    EXPECT_EQ(drawn.to_light, Vector3d(-to_eye));
    EXPECT_EQ(drawn.weight, Vector3d(1.0, 1.0, 1.0));
    EXPECT_EQ(drawn.radiance_scale, 1.0);
  }
}

TEST(Dielectric, RefractsBySnellAndBackAgain) {
  for (const double ior : {1.1, 1.5, 4.0, 1.0 / 1.5, 0.25}) {
    for (std::uint64_t i = 0; i < 300; ++i) {
      const Vector3d to_eye = direction(1e-6 + uniform(i, 0), 2.0 * pi * uniform(i, 1));
      const double sine = std::hypot(to_eye.x(), to_eye.y());
      const double reflected = fresnel_dielectric(to_eye.z(), ior);
      // Just below and above the probability of a reflection.
      const BsdfSample back =
          sample(Dielectric{.ior = ior}, to_eye, reflected * (1.0 - 1e-12), Vector2d(0.1, 0.2));
      EXPECT_FALSE(back.is_transmission);
      EXPECT_EQ(back.to_light, Vector3d(-to_eye.x(), -to_eye.y(), to_eye.z()));
      EXPECT_EQ(back.weight, Vector3d(1.0, 1.0, 1.0));
      if (sine >= ior) {
        EXPECT_EQ(reflected, 1.0);  // total
        continue;
      }
      const BsdfSample on = sample(Dielectric{.ior = ior}, to_eye,
                                   reflected + 1e-12 * (1.0 - reflected), Vector2d(0.1, 0.2));
      ASSERT_TRUE(on.is_transmission);
      EXPECT_LT(on.to_light.z(), 0.0);
      // Near total reflection a rounding of the sine is 1e-8 of the cosine, which is small there.
      EXPECT_NEAR(on.to_light.norm(), 1.0, 1e-14);
      EXPECT_NEAR(std::hypot(on.to_light.x(), on.to_light.y()) * ior, sine, 1e-14);
      EXPECT_NEAR(on.weight.x() * ior * ior, 1.0, 1e-14);
      EXPECT_EQ(on.weight.x(), on.radiance_scale);
      // Seen from the other side, where z is its own.
      const Vector3d from_there(on.to_light.x(), on.to_light.y(), -on.to_light.z());
      const double there = fresnel_dielectric(from_there.z(), 1.0 / ior);
      EXPECT_NEAR(there, reflected, 1e-6);
      const BsdfSample again = sample(Dielectric{.ior = 1.0 / ior}, from_there,
                                      std::min(there + 1e-9, 1.0 - 1e-16), Vector2d(0.1, 0.2));
      EXPECT_NEAR(again.weight.x() * on.weight.x(), 1.0, 1e-14);
      EXPECT_LE((again.to_light - Vector3d(to_eye.x(), to_eye.y(), -to_eye.z())).norm(), 1e-9);
    }
  }
}

// ---- tables ----------------------------------------------------------------------------------

TEST(CoatAlbedo, IsAboveTheTruthAndNear) {
  double highest = 0.0;
  for (std::uint64_t i = 0; i < 300; ++i) {
    // Half of them at small angles, half at small roughness.
    const double cosine = std::pow(uniform(i, 20), i % 2 == 0 ? 1.0 : 3.0);
    const double alpha = std::pow(uniform(i, 21), i % 4 < 2 ? 1.0 : 3.0);
    const double ior = 1.2 + 1.3 * uniform(i, 22);
    const double truth = coat_reflectance_by_quadrature(cosine, alpha, ior, 48, 96);
    const double found = CoatAlbedo::table().reflectance(cosine, alpha, ior);
    EXPECT_GE(found, truth) << cosine << ' ' << alpha << ' ' << ior;
    EXPECT_LE(found, truth + 0.03) << cosine << ' ' << alpha << ' ' << ior;
    highest = std::max(highest, found - truth);
  }
  RecordProperty("highest", std::to_string(highest));
}

TEST(CoatAlbedo, ItsMeanIsAboveThatOfTheTable) {
  for (std::uint64_t i = 0; i < 100; ++i) {
    const double alpha = std::pow(uniform(i, 23), 2.0);
    const double ior = 1.2 + 1.3 * uniform(i, 24);
    double sum = 0.0;
    constexpr int kPoints = 2000;
    for (int j = 0; j < kPoints; ++j) {
      const double s = (j + 0.5) / kPoints;
      sum += CoatAlbedo::table().transmittance(s * s, alpha, ior) * 4.0 * s * s * s / kPoints;
    }
    const double found = CoatAlbedo::table().mean_transmittance(alpha, ior);
    EXPECT_GE(found, sum) << alpha << ' ' << ior;
    EXPECT_LE(found, 1.004 * sum) << alpha << ' ' << ior;
  }
}

}  // namespace
}  // namespace haarlight::render
