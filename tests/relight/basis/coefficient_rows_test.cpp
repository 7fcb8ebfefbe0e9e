// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/coefficient_rows.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/quantiser.h"
#include "relight/basis/plate/counted_rank.h"
#include "relight/basis/plate/plate_gain.h"

namespace haarlight::relight {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

float draw(std::uint64_t a, std::uint64_t b) {
  return static_cast<float>(uniform_unit(hash_key(a, b)) - 0.5);
}

float sorted_at(std::vector<float> values, std::size_t rank) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(rank),
                   values.end());
  return values[rank];
}

/// What a row of ratios may look like; every kind with ties or without.
std::vector<float> made_values(std::size_t kind, std::size_t n, std::uint64_t seed) {
  std::vector<float> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    const float v = draw(seed, i);
    switch (kind) {
      case 0:
        values[i] = v;
        break;
      case 1:  // few different values
        values[i] = std::floor(v * 6.0F) / 4.0F;
        break;
      case 2:  // one value
        values[i] = 0.75F;
        break;
      case 3:  // a narrow peak, zeros of shadows, some far away
        values[i] = v < -0.2F ? 0.0F : v > 0.45F ? 1e30F * v : 1.0F + 1e-3F * v;
        break;
      case 4:  // every magnitude there is
        values[i] = std::ldexp(v, static_cast<int>(300.0F * draw(seed + 1, i)));
        break;
      default:  // both zeros and both infinities
        values[i] = v < -0.3F ? -kInfinity : v < 0.0F ? -0.0F : v < 0.3F ? 0.0F : kInfinity;
    }
  }
  return values;
}

TEST(CountedRank, IsTheSortedValue) {
  CountedRank rank;  // one for all: whatever was found before
  for (std::size_t kind = 0; kind < 6; ++kind) {
    for (const std::size_t n : {1U, 2U, 3U, 7U, 16U, 33U, 64U, 257U, 1024U}) {
      for (std::uint64_t seed = 0; seed < 8; ++seed) {
        const std::vector<float> values = made_values(kind, n, 100 * kind + seed);
        for (const std::size_t at : {std::size_t{0}, n / 3, n / 2, n - 1}) {
          EXPECT_EQ(rank.find(values, at), sorted_at(values, at))
              << "kind " << kind << ", " << n << " values, rank " << at;
        }
      }
    }
  }
}

TEST(CountedRank, RefusesARankThatThereIsNot) {
  CountedRank rank;
  EXPECT_THROW((void)rank.find(std::vector<float>{}, 0), ContractViolation);
  EXPECT_THROW((void)rank.find(std::vector<float>{1.0F}, 1), ContractViolation);
}

/// The gain by its definition.
float defined_gain(const std::vector<float>& t, const std::vector<float>& b) {
  const float largest = *std::max_element(b.begin(), b.end());
  std::vector<float> ratios;
  for (std::size_t k = 0; k < t.size(); ++k) {
    if (b[k] > static_cast<float>(1e-6 * double{largest})) {
      ratios.push_back(t[k] / b[k]);
    }
  }
  if (!(largest > 0.0F)) {
    return 0.0F;
  }
  const float gain = sorted_at(ratios, ratios.size() / 2);
  double before = 0.0;
  double after = 0.0;
  for (std::size_t k = 0; k < t.size(); ++k) {
    before += double{t[k]} * double{t[k]};
    after += std::pow(double{t[k] - gain * b[k]}, 2.0);
  }
  return after < before ? gain : 0.0F;
}

TEST(PlateGain, IsTheMedianOfWhatIsLit) {
  PlateGain gain;
  for (const std::size_t n : {1U, 2U, 5U, 64U, 100U, 1024U}) {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      std::vector<float> t(n);
      std::vector<float> b(n);
      for (std::size_t k = 0; k < n; ++k) {
        b[k] = seed % 3 == 0 && k % 4 == 1 ? -1e-9F : 0.7F + 0.5F * draw(seed, k);
        const bool is_shadowed = draw(seed + 100, k) < -0.2F;
        t[k] = is_shadowed ? 0.01F * draw(seed + 200, k)
                           : 0.8F * b[k] * (1.0F + 0.02F * draw(seed + 300, k));
      }
      EXPECT_EQ(gain(t, b), defined_gain(t, b)) << n << " lights, seed " << seed;
    }
  }
}

template <class Real>
std::vector<Real> made_rows(std::size_t n, std::uint64_t seed) {
  std::vector<Real> rows(n);
  for (std::size_t i = 0; i < n; ++i) {
    rows[i] = static_cast<Real>(std::ldexp(draw(seed, i), static_cast<int>(i % 23)));
  }
  return rows;
}

/// Bit for bit the sums of a plain loop.
template <class Real>
void check_sums() {
  for (const std::size_t n : {1U, 5U, 16U, 31U, 1024U}) {
    for (const std::size_t n_rows : {1U, 7U, 8U, 9U, 17U}) {
      const std::vector<Real> rows = made_rows<Real>(n * n_rows, n + n_rows);
      std::vector<double> sums(n_rows, -1.0);
      sum_squares(rows, sums);
      for (std::size_t i = 0; i < n_rows; ++i) {
        double sum = 0.0;
        for (std::size_t k = 0; k < n; ++k) {
          sum += double{rows[i * n + k]} * double{rows[i * n + k]};
        }
        EXPECT_EQ(sums[i], sum) << n_rows << " rows of " << n;
      }
      std::vector<double> of_lights(n, 0.5);
      Real largest = Real(0);
      for (std::size_t i = 0; i < rows.size(); ++i) {
        of_lights[i % n] += double{rows[i]} * double{rows[i]};
        largest = std::max(largest, std::abs(rows[i]));
      }
      std::vector<double> energies(n, 0.5);
      EXPECT_EQ(add_squares(std::span<const Real>(rows), n_rows, energies.data()), largest);
      EXPECT_EQ(energies, of_lights) << n_rows << " rows of " << n;
      if constexpr (std::is_same_v<Real, float>) {
        std::vector<double> both(n, 0.5);
        std::vector<double> each(n_rows, -1.0);
        EXPECT_EQ(add_squares(std::span<const float>(rows), both.data(), each), largest);
        EXPECT_EQ(both, of_lights);
        EXPECT_EQ(each, sums);
      }
    }
  }
}

TEST(CoefficientRows, SumsAreThoseOfAPlainLoop) {
  check_sums<float>();
  check_sums<double>();
}

TEST(CoefficientRows, TheLargestOfValuesThatAreNotFiniteIsNot) {
  for (const float bad :
       {std::numeric_limits<float>::infinity(), -std::numeric_limits<float>::infinity(),
        std::numeric_limits<float>::quiet_NaN()}) {
    for (const std::size_t n_rows : {3U, 8U}) {
      std::vector<float> rows(n_rows * 16, 1.0F);
      std::vector<double> sums(16);
      rows[n_rows * 16 - 30] = bad;
      EXPECT_FALSE(std::isfinite(add_squares(rows, n_rows, sums.data())));
    }
  }
}

template <class Real>
void check_quantising() {
  for (const std::size_t n : {1U, 9U, 100U, 1024U}) {
    for (const double step : {1e-3, 0.37, 1e6}) {
      const std::vector<Real> row = made_rows<Real>(n, n);
      std::vector<Real> rests = row;
      std::vector<std::int32_t> quanta(n);
      std::vector<double> energies(n, 1.0);
      std::vector<double> errors(n, 2.0);
      quantise_row(step, rests, quanta.data(), energies.data(), errors.data());
      for (std::size_t k = 0; k < n; ++k) {
        const std::int32_t quantum = quantise(row[k], static_cast<Real>(1.0 / step));
        const Real decoded = static_cast<Real>(step) * static_cast<Real>(quantum);
        const Real rest = decoded - row[k];
        EXPECT_EQ(quanta[k], quantum);
        EXPECT_EQ(rests[k], rest);
        EXPECT_EQ(energies[k], 1.0 + double{decoded} * double{decoded});
        EXPECT_EQ(errors[k], 2.0 + double{rest} * double{rest});
      }
    }
  }
}

TEST(CoefficientRows, QuantiseAsOneByOne) {
  check_quantising<float>();
  check_quantising<double>();
}

TEST(CoefficientRows, FindWhatIsNotZero) {
  for (const std::size_t n : {0U, 1U, 15U, 16U, 17U, 100U, 1024U}) {
    for (const float share : {0.0F, 0.02F, 0.5F, 1.0F}) {
      std::vector<std::int32_t> numbers(n);
      std::vector<std::uint32_t> expected;
      for (std::size_t i = 0; i < n; ++i) {
        if (draw(n, i) + 0.5F < share) {
          numbers[i] = i % 2 == 0 ? -1 : std::numeric_limits<std::int32_t>::max();
          expected.push_back(static_cast<std::uint32_t>(i));
        }
      }
      std::vector<std::uint32_t> found(n + kSpareIndices);
      found.resize(find_nonzero(numbers, found.data()));
      EXPECT_EQ(found, expected);
    }
  }
}

TEST(CoefficientRows, SubtractThePlateUnlessItsGainIsZero) {
  const std::vector<float> t = made_rows<float>(37, 1);
  std::vector<float> direction = made_rows<float>(37, 2);
  std::vector<float> out(37);
  subtract_plate(t, 0.3, direction, out.data());
  for (std::size_t k = 0; k < t.size(); ++k) {
    EXPECT_EQ(out[k], t[k] - 0.3F * direction[k]);
  }
  direction.assign(37, std::numeric_limits<float>::quiet_NaN());
  subtract_plate(t, 0.0, direction, out.data());
  EXPECT_EQ(out, t);
}

}  // namespace
}  // namespace haarlight::relight
