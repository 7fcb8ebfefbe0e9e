// SPDX-License-Identifier: Apache-2.0
/// @file
/// Segments of which extinction and colour are parabolas.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "render/volume/segment.h"
#include "tests/golden_file.h"

namespace haarlight::render {
namespace {

double sum(const Parabola& f) { return f.near + f.middle + f.far; }
double dot(const Parabola& k, const Parabola& weights) {
  return k.near * weights.near + k.middle * weights.middle + k.far * weights.far;
}
/// A straight line as a parabola.
Parabola line(double near, double far) {
  return {.near = near, .middle = 0.5 * (near + far), .far = far};
}
/// What a parabola is between s0 and s1.
Parabola part_of(const Parabola& f, double s0, double s1) {
  const auto at = [&](double s, double t) {
    return (1.0 - s) * (1.0 - t) * f.near + ((1.0 - s) * t + s * (1.0 - t)) * f.middle +
           s * t * f.far;
  };
  return {.near = at(s0, s0), .middle = at(s0, s1), .far = at(s1, s1)};
}

/// 1e-13: what the header states.
TEST(QuadraticSegment, WeightsAreThoseOfFortyDigits) {
  const nlohmann::json golden = test::read_golden("volume_segment_sweep.json");
  double worst = 0.0;
  int n_checked = 0;
  for (const auto& item : golden.at("quadratic")) {
    std::vector<double> row;
    for (const auto& value : item) {
      row.push_back(std::strtod(value.get<std::string>().c_str(), nullptr));
    }
    const QuadraticWeights w =
        quadratic_weights({.near = row[0], .middle = row[1], .far = row[2]}, 1.0);
    const std::array<double, 6> ours = {w.of_chromaticity.near, w.of_chromaticity.middle,
                                        w.of_chromaticity.far,  w.of_glow.near,
                                        w.of_glow.middle,       w.of_glow.far};
    for (std::size_t i = 0; i < ours.size(); ++i) {
      const double error = std::abs(ours[i] - row[3 + i]) / row[3 + i];
      EXPECT_LE(error, 1e-13) << i << " of " << row[0] << " " << row[1] << " " << row[2];
      worst = std::max(worst, error);
    }
    ++n_checked;
  }
  std::printf("largest relative error of a weight: %.2g\n", worst);
  EXPECT_EQ(n_checked, 90);
}

/// 1e-13: as above.
TEST(QuadraticSegment, OfStraightLinesIsTheLinearOne) {
  for (const double a : {0.0, 1e-9, 0.1, 0.5, 2.0, 30.0, 1e4, 1e9}) {
    for (const double b : {0.0, 1e-9, 0.1, 0.5, 2.0, 30.0, 1e4, 1e9}) {
      const QuadraticWeights ours = quadratic_weights(line(a, b), 1.0);
      const SegmentWeights truth = weights_of_depths(a, b);
      const Parabola k = line(0.25, 0.75);
      const double of_k = 0.25 * truth.of_chromaticity.near + 0.75 * truth.of_chromaticity.far;
      const double of_g = 0.25 * truth.of_glow.near + 0.75 * truth.of_glow.far;
      EXPECT_NEAR(dot(k, ours.of_chromaticity), of_k, 1e-13 * of_k) << a << " " << b;
      EXPECT_NEAR(dot(k, ours.of_glow), of_g, 1e-13 * of_g) << a << " " << b;
      EXPECT_NEAR(ours.opacity, truth.opacity, 1e-14 * truth.opacity) << a << " " << b;
      EXPECT_NEAR(ours.transparency, truth.transparency,
                  1e-14 * (1.0 + 0.5 * a + 0.5 * b) * truth.transparency);
    }
  }
}

/// 1e-13: as above; weights of chromaticities of 1 sum to the opacity.
TEST(QuadraticSegment, WeightsSumToTheOpacityAndTwoPartsMakeTheWhole) {
  for (std::uint64_t i = 0; i < 3000; ++i) {
    const double scale = std::pow(10.0, -6.0 + 12.0 * uniform_unit(hash_key(1, i)));
    const double near = scale * uniform_unit(hash_key(2, i));
    const double far = scale * uniform_unit(hash_key(3, i));
    const double lowest = -std::sqrt(near * far);
    const double middle = lowest + (scale - lowest) * uniform_unit(hash_key(4, i));
    const Parabola rho{.near = near, .middle = middle, .far = far};
    const double cut = 0.05 + 0.9 * uniform_unit(hash_key(5, i));
    const Parabola k{.near = uniform_unit(hash_key(6, i)),
                     .middle = uniform_unit(hash_key(7, i)),
                     .far = uniform_unit(hash_key(8, i))};
    const QuadraticWeights whole = quadratic_weights(rho, 2.0);
    EXPECT_NEAR(sum(whole.of_chromaticity), whole.opacity, 1e-13 * whole.opacity) << i;
    const QuadraticWeights first = quadratic_weights(part_of(rho, 0.0, cut), 2.0 * cut);
    const QuadraticWeights second =
        quadratic_weights(part_of(rho, cut, 1.0), 2.0 * (1.0 - cut));
    const double of_k = dot(part_of(k, 0.0, cut), first.of_chromaticity) +
                        first.transparency * dot(part_of(k, cut, 1.0), second.of_chromaticity);
    EXPECT_NEAR(of_k, dot(k, whole.of_chromaticity), 1e-13 * of_k) << i;
    const double of_g =
        cut * dot(part_of(k, 0.0, cut), first.of_glow) +
        (1.0 - cut) * first.transparency * dot(part_of(k, cut, 1.0), second.of_glow);
    EXPECT_NEAR(of_g, dot(k, whole.of_glow), 1e-13 * of_g) << i;
  }
}

/// The bounds are those of the header.
TEST(QuadraticSegment, FivePointsAreOffByWhatIsStated) {
  const auto largest_error = [](double depth) {
    double worst = 0.0;
    for (std::uint64_t i = 0; i < 2000; ++i) {
      Parabola rho{.near = uniform_unit(hash_key(1, i)),
                   .middle = uniform_unit(hash_key(2, i)),
                   .far = uniform_unit(hash_key(3, i))};
      const double length = 3.0 * depth / sum(rho);
      const Parabola k{.near = uniform_unit(hash_key(4, i)),
                       .middle = uniform_unit(hash_key(5, i)),
                       .far = uniform_unit(hash_key(6, i))};
      const double truth = dot(k, quadratic_weights(rho, length).of_chromaticity);
      const double five = dot(k, five_point_weights(rho, length).of_chromaticity);
      worst = std::max(worst, std::abs(five - truth) / truth);
    }
    std::printf("five points, depth %g: off by up to %.2g\n", depth, worst);
    return worst;
  };
  const double at_one = largest_error(1.0);
  EXPECT_LE(at_one, 2e-4);
  EXPECT_GE(at_one, 5e-5);
  const double at_ten = largest_error(10.0);
  EXPECT_LE(at_ten, 0.15);
  EXPECT_GE(at_ten, 0.1);
  EXPECT_GE(largest_error(100.0), 0.9);
}

TEST(QuadraticSegment, StopsWhereTheFractionIsReached) {
  const Parabola rho{.near = 100.0, .middle = 300.0, .far = 200.0};
  const QuadraticWeights fine = quadratic_weights(rho, 1.0);
  const QuadraticWeights coarse = quadratic_weights(rho, 1.0, 1e-4);
  EXPECT_LT(coarse.n_pieces, fine.n_pieces);
  EXPECT_LE(fine.n_pieces, 2 + static_cast<int>(4.0 * std::log(1e17)));
  EXPECT_LE(fine.opacity - sum(coarse.of_chromaticity), 1e-4);
  EXPECT_GT(fine.opacity - sum(coarse.of_chromaticity), 1e-8);
  // Nothing is left out at the default's fraction.
  EXPECT_NEAR(sum(fine.of_chromaticity), 1.0, 1e-14);
}

TEST(QuadraticSegment, IsSoundAtAnyDepth) {
  for (const double size : {0.0, 5e-324, 1e-300, 1e-20, 1.0, 1e20, 1e300}) {
    for (const Parabola& shape :
         {Parabola{1.0, 0.0, 0.0}, Parabola{0.0, 1.0, 0.0}, Parabola{0.0, 0.0, 1.0},
          Parabola{1.0, -1.0, 1.0}, Parabola{1.0, 1.0, 1.0}}) {
      const Parabola rho{size * shape.near, size * shape.middle, size * shape.far};
      const QuadraticWeights w = quadratic_weights(rho, 1.0);
      for (const double weight :
           {w.of_chromaticity.near, w.of_chromaticity.middle, w.of_chromaticity.far,
            w.of_glow.near, w.of_glow.middle, w.of_glow.far, w.opacity, w.transparency}) {
        EXPECT_TRUE(std::isfinite(weight) && weight >= 0.0 && weight <= 1.0 + 1e-14)
            << weight << " at " << size;
      }
      EXPECT_NEAR(sum(w.of_chromaticity), w.opacity, 1e-13 * w.opacity + 5e-324) << size;
    }
  }
}

TEST(QuadraticSegment, RefusesNegativeExtinction) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW((void)quadratic_weights({1.0, -1.1, 1.0}, 1.0), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({0.0, -0.1, 1.0}, 1.0), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({-0.1, 1.0, 1.0}, 1.0), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({1.0, nan, 1.0}, 1.0), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({1.0, 1.0, 1.0}, nan), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({1.0, 1.0, 1.0}, -1.0), ContractViolation);
  EXPECT_THROW((void)quadratic_weights({1.0, 1.0, 1.0}, 1.0, 0.0), ContractViolation);
  EXPECT_NO_THROW((void)quadratic_weights({1.0, -1.0, 1.0}, 1.0));
}

}  // namespace
}  // namespace haarlight::render
