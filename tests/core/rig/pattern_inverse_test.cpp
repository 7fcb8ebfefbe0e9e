// SPDX-License-Identifier: Apache-2.0
#include "core/rig/pattern_inverse.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "tests/core/rig/pattern_matrices.h"

namespace haarlight {
namespace {

double random_value(std::uint64_t a, std::uint64_t b, std::uint64_t seed = 3) {
  return uniform_unit(hash_key(seed, a, b));
}

std::vector<double> random_values(std::size_t n, std::uint64_t seed) {
  std::vector<double> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = random_value(i, 0, seed);
  }
  return values;
}

std::vector<std::vector<LightDriveLevel>> shots_of(const PatternParameters& parameters,
                                                   double drive) {
  std::vector<std::vector<LightDriveLevel>> shots;
  for (const std::vector<int>& lights : lit_lights(parameters)) {
    shots.emplace_back();
    for (const int light : lights) {
      shots.back().push_back({light, drive});
    }
  }
  return shots;
}

PatternInverse inverse_of(const PatternParameters& parameters, double drive = 1.0) {
  return {parameters, shots_of(parameters, drive), parameters.n_lights()};
}

PatternParameters parameters_of(PatternFamily family, std::vector<FaceGrid> faces,
                                int bin = 0) {
  PatternParameters parameters{family, std::move(faces), bin, {}};
  if (family == PatternFamily::haar) {
    parameters.wavelets.resize(static_cast<std::size_t>(parameters.n_lights()));
    std::iota(parameters.wavelets.begin(), parameters.wavelets.end(), 0);
  }
  return parameters;
}

double worst(std::span<const double> a, std::span<const double> b) {
  double error = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    error = std::max(error, std::abs(a[i] - b[i]));
  }
  return error;
}

/// Shots of random lights, undone.
std::vector<double> there_and_back(const PatternInverse& inverse,
                                   const std::vector<double>& lights, std::size_t width,
                                   const std::vector<double>& plate = {}) {
  std::vector<double> measured(static_cast<std::size_t>(inverse.n_shots()) * width);
  inverse.shoot(lights, width, measured);
  std::vector<double> back(lights.size());
  inverse.apply(measured, plate, width, back);
  return back;
}

TEST(WalshHadamard, IsItsOwnInverseTimesTheOrder) {
  for (const std::size_t n : {1U, 2U, 4U, 8U, 32U, 128U}) {
    const std::vector<double> x = random_values(n * 3, n);
    std::vector<double> y = x;
    walsh_hadamard(y, n, 3);
    for (std::size_t row = 0; row < n; ++row) {
      double sum = 0.0;  // row `row` of H x, column 1
      for (std::size_t k = 0; k < n; ++k) {
        sum += (std::popcount(row & k) % 2 == 0 ? 1.0 : -1.0) * x[k * 3 + 1];
      }
      EXPECT_NEAR(y[row * 3 + 1], sum, 1e-12);
    }
    walsh_hadamard(y, n, 3);
    for (double& value : y) {
      value /= static_cast<double>(n);
    }
    EXPECT_LT(worst(x, y), 1e-13);
  }
}

TEST(PatternInverse, FastSMatrixEqualsTheDenseOne) {
  for (const int order : {3, 7, 11, 19, 63, 127, 131}) {
    const auto n = static_cast<std::size_t>(order);
    const std::vector<double> m = random_values(n * 2, 5);
    std::vector<double> fast = m;
    s_matrix_inverse(order, fast, 2);
    const Eigen::MatrixXd s = test::s_matrix(order);
    const Eigen::MatrixXd dense =
        2.0 / (order + 1) * (2.0 * s.transpose() - Eigen::MatrixXd::Ones(order, order));
    for (int k = 0; k < order; ++k) {
      double sum = 0.0;
      for (int j = 0; j < order; ++j) {
        sum += dense(k, j) * m[static_cast<std::size_t>(j) * 2 + 1];
      }
      // Sums of `order` terms below 2/order each.
      EXPECT_NEAR(fast[static_cast<std::size_t>(k) * 2 + 1], sum, 1e-14) << order;
    }
  }
}

TEST(PatternInverse, TheFastSMatrixIsExactOnWholeNumbers) {
  // Counts of 16 bits: sums below 2^53, and 2/(n + 1) is a power of two.
  constexpr int kOrder = 255;
  std::vector<double> x(kOrder);
  std::vector<std::int64_t> counts(kOrder);
  for (std::size_t j = 0; j < kOrder; ++j) {
    counts[j] = static_cast<std::int64_t>(hash_key(1, j) % 65536);
    x[j] = static_cast<double>(counts[j]);
  }
  s_matrix_inverse(kOrder, x, 1);
  for (int k = 0; k < kOrder; ++k) {
    std::int64_t sum = 0;
    for (int j = 0; j < kOrder; ++j) {
      sum += (s_entry(kOrder, j, k) ? 1 : -1) * counts[static_cast<std::size_t>(j)];
    }
    EXPECT_EQ(x[static_cast<std::size_t>(k)] * 128.0, static_cast<double>(sum));
  }
}

TEST(PatternInverse, CompleteFamiliesGiveEveryLightBack) {
  for (const PatternParameters& parameters :
       {parameters_of(PatternFamily::one_at_a_time, {{3, 5}}),
        parameters_of(PatternFamily::bins, {{4, 6}, {2, 3}}, 1),
        parameters_of(PatternFamily::s_matrix, {{8, 8}}),
        parameters_of(PatternFamily::s_matrix, {{4, 4}, {4, 4}, {4, 4}}),
        parameters_of(PatternFamily::s_matrix, {{5, 5}, {3, 2}, {1, 1}}),
        parameters_of(PatternFamily::haar, {{8, 8}}),
        parameters_of(PatternFamily::haar, {{4, 4}, {4, 4}})}) {
    const PatternInverse inverse = inverse_of(parameters, 0.75);
    EXPECT_FALSE(inverse.needs_plate());
    const std::vector<double> lights =
        random_values(static_cast<std::size_t>(parameters.n_lights()) * 3, 11);
    // Condition number below 64, sums of at most 64 terms of 2^-52.
    EXPECT_LT(worst(there_and_back(inverse, lights, 3), lights), 1e-12)
        << to_string(parameters.family) << " of " << parameters.n_lights();
  }
}

TEST(PatternInverse, BinsAreExactWhereTheObjectIsThePlateTimesAGain) {
  const PatternParameters parameters = parameters_of(PatternFamily::bins, {{8, 8}}, 4);
  const PatternInverse inverse = inverse_of(parameters);
  EXPECT_TRUE(inverse.needs_plate());
  const std::vector<double> plate = random_values(64, 2);
  std::vector<double> lights = plate;
  for (double& value : lights) {
    value *= 0.3;
  }
  EXPECT_LT(worst(there_and_back(inverse, lights, 1, plate), lights), 1e-14);
}

TEST(PatternInverse, BinsKeepEveryShot) {
  const PatternInverse inverse = inverse_of(parameters_of(PatternFamily::bins, {{8, 8}}, 2));
  const std::vector<double> plate = random_values(128, 2);
  const std::vector<double> lights = random_values(128, 4);
  const std::vector<double> back = there_and_back(inverse, lights, 2, plate);
  std::vector<double> a(32);
  std::vector<double> b(32);
  inverse.shoot(lights, 2, a);
  inverse.shoot(back, 2, b);
  EXPECT_LT(worst(a, b), 1e-14);
}

TEST(PatternInverse, APixelThatThePlateDoesNotSeeIsDistributedEvenly) {
  const PatternInverse inverse = inverse_of(parameters_of(PatternFamily::bins, {{4, 4}}, 2));
  const std::vector<double> back =
      there_and_back(inverse, random_values(16, 4), 1, std::vector<double>(16, 0.0));
  EXPECT_EQ(back[0], back[1]);
  EXPECT_EQ(back[0], back[5]);
}

TEST(PatternInverse, ATargetShotGivesItsLightingBackExactly) {
  PatternParameters parameters;
  parameters.family = PatternFamily::target;
  std::vector<std::vector<LightDriveLevel>> shots(3);
  for (std::size_t c = 0; c < 3; ++c) {
    for (int k = 0; k < 20; ++k) {
      const double drive = random_value(static_cast<std::uint64_t>(k), c, 8);
      if (drive > 0.3) {
        shots[c].push_back({k, drive});
      }
    }
  }
  const PatternInverse inverse(parameters, shots, 20);
  const std::vector<double> lights = random_values(40, 9);
  const std::vector<double> back = there_and_back(inverse, lights, 2, random_values(40, 10));
  std::vector<double> truth(6);
  std::vector<double> relit(6);
  inverse.shoot(lights, 2, truth);
  inverse.shoot(back, 2, relit);
  EXPECT_LT(worst(truth, relit), 1e-12);
}

TEST(PatternInverse, EqualColoursOfATargetDoNotBlowUp) {
  PatternParameters parameters;
  parameters.family = PatternFamily::target;
  const std::vector<LightDriveLevel> shot{{0, 1.0}, {1, 0.5}, {2, 0.25}};
  const PatternInverse inverse(parameters, {shot, shot}, 3);
  std::vector<double> lights(3);
  const std::vector<double> measured{1.01, 0.99};  // the same shot twice, noisy
  inverse.apply(measured, {}, 1, lights);
  std::vector<double> again(2);
  inverse.shoot(lights, 1, again);
  EXPECT_NEAR(again[0], 1.0, 1e-9);
}

TEST(PatternInverse, SomeWaveletsAreTheTruncatedSeriesAndThePlateFillsTheRest) {
  PatternParameters parameters{PatternFamily::haar, {{8, 8}}, 0, {0, 1, 8, 9, 18}};
  const PatternInverse inverse = inverse_of(parameters);
  EXPECT_EQ(inverse.n_shots(), 9);
  const std::vector<double> lights = random_values(64, 6);
  // Without a plate: the truncated series.
  std::vector<double> series = lights;
  lights_to_wavelets(8, series, 1);
  for (int i = 0; i < 64; ++i) {
    if (std::find(parameters.wavelets.begin(), parameters.wavelets.end(), i) ==
        parameters.wavelets.end()) {
      series[static_cast<std::size_t>(i)] = 0.0;
    }
  }
  wavelets_to_lights(8, series, 1);
  EXPECT_LT(worst(there_and_back(inverse, lights, 1), series), 1e-13);
  // With one: exact where the object is the plate times a gain.
  std::vector<double> dimmed = lights;
  for (double& value : dimmed) {
    value *= 0.4;
  }
  EXPECT_LT(worst(there_and_back(inverse, dimmed, 1, lights), dimmed), 1e-13);
}

/// Every family, and whether it is given a plate.
std::vector<std::pair<PatternInverse, bool>> all_families() {
  PatternParameters target;
  target.family = PatternFamily::target;
  std::vector<std::pair<PatternInverse, bool>> cases;
  const std::vector<FaceGrid> faces{{4, 4}, {4, 4}};
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::one_at_a_time, faces), 0.5),
                     false);
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::bins, faces, 2)), true);
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::s_matrix, faces), 0.5), false);
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::s_matrix, {{5, 5}, {1, 7}})),
                     false);
  cases.emplace_back(
      inverse_of(PatternParameters{PatternFamily::haar, faces, 0, {0, 1, 7, 16, 30}}, 0.9),
      true);
  cases.emplace_back(
      PatternInverse(target, {{{0, 1.0}, {3, 0.2}, {9, 0.4}}, {{1, 0.7}, {3, 1.0}}}, 32), true);
  cases.emplace_back(
      PatternInverse({}, {{{0, 1.0}, {1, 1.0}}, {{1, 1.0}, {2, 0.5}}, {{0, 1.0}, {2, 1.0}}}, 3),
      false);
  return cases;
}

TEST(PatternInverse, ShotWeightsAreTheAdjoint) {
  for (const auto& [inverse, has_plate] : all_families()) {
    const auto n = static_cast<std::size_t>(inverse.n_lights());
    const auto m = static_cast<std::size_t>(inverse.n_shots());
    const std::vector<double> w = random_values(n, 21);
    const std::vector<double> plate = has_plate ? random_values(n, 22) : std::vector<double>();
    const std::vector<double> measured = random_values(m, 23);
    std::vector<double> lights(n);
    std::vector<double> a(m);
    inverse.apply(measured, plate, 1, lights);
    inverse.shot_weights(w, plate, a);
    const double left = std::inner_product(w.begin(), w.end(), lights.begin(), 0.0);
    const double right = std::inner_product(a.begin(), a.end(), measured.begin(), 0.0);
    EXPECT_NEAR(left, right, 1e-11 * (1.0 + std::abs(left)))
        << to_string(inverse.parameters().family);
  }
}

TEST(PatternInverse, VariancesAreTheSquaredRowsOfTheInverse) {
  auto cases = all_families();
  const std::vector<FaceGrid> faces{{4, 4}, {4, 4}};
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::haar, faces), 0.7), false);
  cases.emplace_back(
      inverse_of(PatternParameters{PatternFamily::haar, faces, 0, {0, 1, 7, 16, 30}}), false);
  cases.emplace_back(inverse_of(parameters_of(PatternFamily::bins, faces, 4)), false);
  constexpr std::size_t kPixels = 3;
  for (const auto& [inverse, has_plate] : cases) {
    const auto n = static_cast<std::size_t>(inverse.n_lights());
    const auto m = static_cast<std::size_t>(inverse.n_shots());
    std::vector<double> plate =
        has_plate ? random_values(n * kPixels, 22) : std::vector<double>();
    for (std::size_t k = 0; has_plate && k < n; ++k) {
      plate[k * kPixels + 2] = 0.0;  // a pixel that the plate does not see
    }
    const std::vector<double> variance = random_values(m * kPixels, 23);
    std::vector<double> lights(n * kPixels);
    inverse.apply_variance(variance, plate, kPixels, lights);
    // Column j of the inverse is what a unit of shot j alone gives.
    std::vector<double> expected(n * kPixels, 0.0);
    for (std::size_t j = 0; j < m; ++j) {
      std::vector<double> unit(m * kPixels, 0.0);
      std::fill_n(unit.begin() + static_cast<std::ptrdiff_t>(j * kPixels), kPixels, 1.0);
      std::vector<double> column(n * kPixels);
      inverse.apply(unit, plate, kPixels, column);
      for (std::size_t at = 0; at < expected.size(); ++at) {
        expected[at] += column[at] * column[at] * variance[j * kPixels + at % kPixels];
      }
    }
    for (std::size_t at = 0; at < expected.size(); ++at) {
      ASSERT_NEAR(lights[at], expected[at], 1e-12 * (1.0 + expected[at]))
          << to_string(inverse.parameters().family) << ", light " << at / kPixels;
    }
  }
}

TEST(PatternInverse, SMatrixNoiseIsTheWeighingDesigns) {
  // One light's variance for read noise 1: sum of squares of a row of S^-1 = 4 n/(n + 1)^2.
  const PatternInverse inverse = inverse_of(parameters_of(PatternFamily::s_matrix, {{9, 7}}));
  std::vector<double> w(63, 0.0);
  w[17] = 1.0;
  std::vector<double> a(63);
  inverse.shot_weights(w, {}, a);
  EXPECT_NEAR(std::inner_product(a.begin(), a.end(), a.begin(), 0.0), 4.0 * 63 / (64.0 * 64.0),
              1e-14);
}

TEST(PatternInverse, RefusesOtherShotsThanTheParameters) {
  const PatternParameters parameters = parameters_of(PatternFamily::s_matrix, {{4, 4}});
  std::vector<std::vector<LightDriveLevel>> shots = shots_of(parameters, 1.0);
  std::swap(shots[0], shots[1]);
  EXPECT_THROW(PatternInverse(parameters, shots, 16), ContractViolation);
  EXPECT_THROW(PatternInverse({}, {{{0, 1.0}, {1, 1.0}}}, 2), Error);
}

RC_GTEST_PROP(PatternInverse, IsLinear, ()) {
  const auto seed = *rc::gen::arbitrary<std::uint16_t>();
  const PatternInverse inverse =
      inverse_of(PatternParameters{PatternFamily::haar, {{4, 4}}, 0, {0, 3, 5, 12}});
  const auto m = static_cast<std::size_t>(inverse.n_shots());
  const std::vector<double> plate = random_values(16, 1);
  const std::vector<double> x = random_values(m, seed);
  const std::vector<double> y = random_values(m, seed + 1U);
  std::vector<double> sum(m);
  for (std::size_t j = 0; j < m; ++j) {
    sum[j] = 2.0 * x[j] - y[j];
  }
  std::vector<double> tx(16);
  std::vector<double> ty(16);
  std::vector<double> ts(16);
  inverse.apply(x, plate, 1, tx);
  inverse.apply(y, plate, 1, ty);
  inverse.apply(sum, plate, 1, ts);
  for (std::size_t k = 0; k < 16; ++k) {
    RC_ASSERT(std::abs(ts[k] - 2.0 * tx[k] + ty[k]) < 1e-12);
  }
}

}  // namespace
}  // namespace haarlight
