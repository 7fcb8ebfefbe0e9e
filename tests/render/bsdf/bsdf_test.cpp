// SPDX-License-Identifier: Apache-2.0
#include "render/bsdf/bsdf.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

Vector3d direction(double cosine, double phi) {
  const double sine = std::sqrt(1.0 - cosine * cosine);
  return {sine * std::cos(phi), sine * std::sin(phi), cosine};
}

double uniform(std::uint64_t a, std::uint64_t b) { return uniform_unit(hash_key(91, a, b)); }

const std::vector<Bsdf> kBsdfs = {
    {.kd = Vector3d(0.8, 0.5, 0.2)},
    {.kd = Vector3d::Constant(0.4), .ks = 0.3, .exponent = 1.0},
    {.kd = Vector3d::Constant(0.2), .ks = 0.5, .exponent = 40.0},
    {.ks = 0.7, .exponent = 400.0},
};

TEST(Bsdf, IsReciprocal) {
  for (const Bsdf& bsdf : kBsdfs) {
    for (std::uint64_t i = 0; i < 500; ++i) {
      const Vector3d a = direction(uniform(i, 0), 2.0 * pi * uniform(i, 1));
      const Vector3d b = direction(uniform(i, 2), 2.0 * pi * uniform(i, 3));
      const Vector3d there = evaluate(bsdf, a, b);
      EXPECT_LE((there - evaluate(bsdf, b, a)).norm(), 1e-12 * there.norm());
    }
  }
}

TEST(Bsdf, NothingPassesThrough) {
  for (const Bsdf& bsdf : kBsdfs) {
    EXPECT_TRUE(evaluate(bsdf, direction(0.5, 1.0), -direction(0.5, 2.0)).isZero(0.0));
    EXPECT_TRUE(evaluate(bsdf, -direction(0.5, 1.0), direction(0.5, 2.0)).isZero(0.0));
    EXPECT_EQ(density(bsdf, direction(0.5, 1.0), -direction(0.5, 2.0)), 0.0);
    EXPECT_EQ(sample(bsdf, -direction(0.5, 1.0), 0.5, Vector2d(0.5, 0.5)).density, 0.0);
  }
  EXPECT_EQ(sample(Bsdf{}, direction(0.5, 1.0), 0.5, Vector2d(0.5, 0.5)).density, 0.0);
}

/// Samples in cells of (cos theta, phi) against the integral of the density over each: Pearson's
/// chi squared, normal at so many cells. One in 15 000 honest runs is above 4 deviations.
TEST(Bsdf, SamplesFollowTheirDensity) {
  constexpr int kRows = 20;
  constexpr int kColumns = 30;
  constexpr int kFine = 12;  // points of a cell, each way, for the integral
  constexpr int kSamples = 400000;
  for (const Bsdf& bsdf : kBsdfs) {
    for (const double cosine : {0.95, 0.6, 0.15}) {
      const Vector3d to_eye = direction(cosine, 0.7);
      const auto cell = [](int row, int column) {
        return static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column);
      };
      std::vector<double> counts(std::size_t{kRows} * kColumns, 0.0);
      double lost = 0.0;
      for (std::uint64_t i = 0; i < kSamples; ++i) {
        const BsdfSample drawn =
            sample(bsdf, to_eye, uniform(i, 4), Vector2d(uniform(i, 5), uniform(i, 6)));
        if (!(drawn.density > 0.0)) {
          ++lost;
          continue;
        }
        EXPECT_NEAR(drawn.to_light.norm(), 1.0, 1e-12);
        const double phi = std::atan2(drawn.to_light.y(), drawn.to_light.x());
        const int row = std::min(kRows - 1, static_cast<int>(drawn.to_light.z() * kRows));
        const int column = std::min(
            kColumns - 1,
            static_cast<int>((phi < 0.0 ? phi + 2.0 * pi : phi) / (2.0 * pi) * kColumns));
        ++counts[cell(row, column)];
      }
      double chi2 = 0.0;
      int cells = 0;
      double rest_expected = 0.0;
      double rest_counted = 0.0;
      double inside = 0.0;
      for (int row = 0; row < kRows; ++row) {
        for (int column = 0; column < kColumns; ++column) {
          double expected = 0.0;
          for (int i = 0; i < kFine * kFine; ++i) {
            const double z = (row + (i / kFine + 0.5) / kFine) / kRows;  // NOLINT
            const double phi = 2.0 * pi * (column + (i % kFine + 0.5) / kFine) / kColumns;
            expected += density(bsdf, to_eye, direction(z, phi));
          }
          expected *= kSamples * 2.0 * pi / (kRows * kColumns * kFine * kFine);
          inside += expected;
          const double counted = counts[cell(row, column)];
          if (expected < 20.0) {
            rest_expected += expected;
            rest_counted += counted;
            continue;
          }
          chi2 += (counted - expected) * (counted - expected) / expected;
          ++cells;
        }
      }
      if (rest_expected >= 20.0) {
        chi2 += (rest_counted - rest_expected) * (rest_counted - rest_expected) / rest_expected;
        ++cells;
      }
      // A lobe of exponent 400 is narrower than a cell's points: only its whole is compared.
      if (bsdf.exponent < 100.0) {
        EXPECT_LT((chi2 - cells) / std::sqrt(2.0 * cells), 4.0)
            << bsdf.exponent << ' ' << cosine << ": " << chi2 << " in " << cells;
        EXPECT_NEAR(inside / kSamples, 1.0 - lost / kSamples, 0.005);
      }
    }
  }
}

TEST(Bsdf, ALambertianReflectsItsAlbedo) {
  const Bsdf& bsdf = kBsdfs[0];
  const Vector3d to_eye = direction(0.4, 0.3);
  for (std::uint64_t i = 0; i < 100; ++i) {
    const BsdfSample drawn =
        sample(bsdf, to_eye, uniform(i, 7), Vector2d(uniform(i, 8), uniform(i, 9)));
    EXPECT_LE((drawn.f * drawn.to_light.z() / drawn.density - bsdf.kd).norm(), 1e-12);
  }
}

}  // namespace
}  // namespace haarlight::render
