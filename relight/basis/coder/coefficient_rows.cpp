// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/coefficient_rows.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/vector_clones.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/quantiser.h"

#define HAARLIGHT_WIDER HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")

namespace haarlight::relight {

namespace {

constexpr std::size_t kAbreast = 8;  // rows whose sums are formed at a time
constexpr std::size_t kBlock = 16;   // numbers looked at together

template <class Real>
[[gnu::always_inline]] inline Real add_squares_of(const Real* __restrict values, std::size_t n,
                                                  double* __restrict sums) {
  Real largest = Real(0);
  for (std::size_t k = 0; k < n; ++k) {
    sums[k] += double{values[k]} * double{values[k]};
  }
  for (std::size_t k = 0; k < n; ++k) {
    const Real magnitude = std::abs(values[k]);
    largest = largest < magnitude ? magnitude : largest;
  }
  return largest;
}

/// Each row's sum in the order of its values.
template <class Real>
[[gnu::always_inline]] inline void sum_eight(const Real* rows, std::size_t n, double* sums) {
  std::array<double, kAbreast> each{};
  for (std::size_t k = 0; k < n; k += kBlock) {
    const std::size_t size = std::min(kBlock, n - k);
    std::array<Real, kBlock * kAbreast> block{};  // (values, rows)
    for (std::size_t i = 0; i < kAbreast; ++i) {
      for (std::size_t j = 0; j < size; ++j) {
        block[j * kAbreast + i] = rows[i * n + k + j];
      }
    }
    for (std::size_t j = 0; j < size; ++j) {
      for (std::size_t i = 0; i < kAbreast; ++i) {
        each[i] += double{block[j * kAbreast + i]} * double{block[j * kAbreast + i]};
      }
    }
  }
  std::copy(each.begin(), each.end(), sums);
}

template <class Real>
void sum_rows(std::span<const Real> rows, std::span<double> sums,
              void (*eight)(const Real*, std::size_t, double*)) {
  HAARLIGHT_EXPECTS(!sums.empty() && rows.size() % sums.size() == 0, "rows of equal length");
  const std::size_t n = rows.size() / sums.size();
  std::size_t i = 0;
  for (; i + kAbreast <= sums.size(); i += kAbreast) {
    eight(rows.data() + i * n, n, sums.data() + i);
  }
  for (; i < sums.size(); ++i) {
    sums[i] = 0.0;
    for (const Real v : rows.subspan(i * n, n)) {
      sums[i] += double{v} * double{v};
    }
  }
}

template <class Real>
[[gnu::always_inline]] inline void quantise_all(Real step, Real inverse, std::size_t n,
                                                Real* __restrict row,
                                                std::int32_t* __restrict quanta,
                                                double* __restrict energies,
                                                double* __restrict errors) {
  for (std::size_t k = 0; k < n; ++k) {
    const std::int32_t quantum = quantise(row[k], inverse);
    const Real decoded = step * static_cast<Real>(quantum);
    const Real rest = decoded - row[k];
    quanta[k] = quantum;
    energies[k] += double{decoded} * double{decoded};
    errors[k] += double{rest} * double{rest};
    row[k] = rest;
  }
}

template <class Real>
[[gnu::always_inline]] inline void subtract_scaled(const float* __restrict t, Real gain,
                                                   const Real* __restrict direction,
                                                   std::size_t n, Real* __restrict out) {
  for (std::size_t k = 0; k < n; ++k) {
    out[k] = static_cast<Real>(t[k]) - gain * direction[k];
  }
}

HAARLIGHT_WIDER float squares_float(const float* values, std::size_t n, double* sums) {
  return add_squares_of(values, n, sums);
}
HAARLIGHT_WIDER double squares_double(const double* values, std::size_t n, double* sums) {
  return add_squares_of(values, n, sums);
}
HAARLIGHT_WIDER void eight_float(const float* rows, std::size_t n, double* sums) {
  sum_eight(rows, n, sums);
}
HAARLIGHT_WIDER void eight_double(const double* rows, std::size_t n, double* sums) {
  sum_eight(rows, n, sums);
}
HAARLIGHT_WIDER void quantise_float(float step, float inverse, std::size_t n, float* row,
                                    std::int32_t* quanta, double* energies, double* errors) {
  quantise_all(step, inverse, n, row, quanta, energies, errors);
}
HAARLIGHT_WIDER void quantise_double(double step, double inverse, std::size_t n, double* row,
                                     std::int32_t* quanta, double* energies, double* errors) {
  quantise_all(step, inverse, n, row, quanta, energies, errors);
}
HAARLIGHT_WIDER void subtract_float(const float* t, float gain, const float* direction,
                                    std::size_t n, float* out) {
  subtract_scaled(t, gain, direction, n, out);
}
HAARLIGHT_WIDER void subtract_double(const float* t, double gain, const double* direction,
                                     std::size_t n, double* out) {
  subtract_scaled(t, gain, direction, n, out);
}

/// 0 where all of a block's numbers are.
[[gnu::always_inline]] inline std::int32_t any_of_block(const std::int32_t* numbers) {
  std::int32_t all = 0;
  for (std::size_t i = 0; i < kBlock; ++i) {
    all |= numbers[i];
  }
  return all;
}

}  // namespace

float add_squares(std::span<const float> values, double* sums) {
  return squares_float(values.data(), values.size(), sums);
}
double add_squares(std::span<const double> values, double* sums) {
  return squares_double(values.data(), values.size(), sums);
}

void sum_squares(std::span<const float> rows, std::span<double> sums) {
  sum_rows<float>(rows, sums, eight_float);
}
void sum_squares(std::span<const double> rows, std::span<double> sums) {
  sum_rows<double>(rows, sums, eight_double);
}

void quantise_row(double step, std::span<float> row, std::int32_t* quanta, double* energies,
                  double* errors) {
  quantise_float(static_cast<float>(step), static_cast<float>(1.0 / step), row.size(),
                 row.data(), quanta, energies, errors);
}
void quantise_row(double step, std::span<double> row, std::int32_t* quanta, double* energies,
                  double* errors) {
  quantise_double(step, 1.0 / step, row.size(), row.data(), quanta, energies, errors);
}

std::size_t find_nonzero(std::span<const std::int32_t> numbers, std::uint32_t* at) {
  std::size_t n = 0;
  for (std::size_t k = 0; k < numbers.size(); k += kBlock) {
    const std::size_t end = std::min(numbers.size(), k + kBlock);
    if (end == k + kBlock && any_of_block(numbers.data() + k) == 0) {
      continue;  // most of them
    }
    for (std::size_t i = k; i < end; ++i) {
      at[n] = static_cast<std::uint32_t>(i);
      n += numbers[i] != 0 ? 1U : 0U;
    }
  }
  return n;
}

void subtract_plate(std::span<const float> t, double gain, std::span<const float> direction,
                    float* out) {
  const auto g = static_cast<float>(gain);
  if (g == 0.0F) {
    std::copy(t.begin(), t.end(), out);
  } else {
    subtract_float(t.data(), g, direction.data(), t.size(), out);
  }
}
void subtract_plate(std::span<const float> t, double gain, std::span<const double> direction,
                    double* out) {
  if (gain == 0.0) {
    std::copy(t.begin(), t.end(), out);
  } else {
    subtract_double(t.data(), gain, direction.data(), t.size(), out);
  }
}

}  // namespace haarlight::relight
