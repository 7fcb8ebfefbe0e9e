// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/coefficient_rows.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <type_traits>

#include "haarlight/core/error.h"
#include "relight/basis/by_kernel.h"
#include "relight/basis/coder/quantiser.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

constexpr std::size_t kAbreast = 8;  // rows whose sums are formed at a time
constexpr std::size_t kBlock = 16;   // numbers looked at together

/// Magnitudes of floats in the order of whole numbers, of which compilers make vectors.
template <class Real>
using Bits = std::conditional_t<std::is_same_v<Real, float>, std::int32_t, std::int64_t>;

struct AddSquares {
  template <class Real>
  [[gnu::always_inline]] static inline Real run(const Real* __restrict values, std::size_t n,
                                                double* __restrict sums) {
    Bits<Real> largest = 0;
    for (std::size_t k = 0; k < n; ++k) {
      sums[k] += double{values[k]} * double{values[k]};
    }
    for (std::size_t k = 0; k < n; ++k) {
      const auto magnitude =
          std::bit_cast<Bits<Real>>(values[k]) & std::numeric_limits<Bits<Real>>::max();
      largest = largest < magnitude ? magnitude : largest;
    }
    return std::bit_cast<Real>(largest);
  }
};

/// Each row's sum in the order of its values.
struct SumEight {
  template <class Real>
  [[gnu::always_inline]] static inline void run(const Real* rows, std::size_t n, double* sums) {
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
};

#if defined(__x86_64__)
/// Sums over eight rows of floats: of each light where `columns` is not null, of each row where
/// `each` is not. A light's rows and a row's lights are added in their order.
/// @param n  a multiple of 8
/// @return  the largest magnitude, as bits
template <bool kHasColumns, bool kHasRows>
[[gnu::target(HAARLIGHT_AVX512)]] std::int32_t squares_avx512(const float* rows, std::size_t n,
                                                              double* columns, double* each) {
  constexpr __mmask8 kAll = 0xff;  // unmasked, GCC 12 warns of a register of its own
  const __m256i no_sign = _mm256_set1_epi32(0x7fffffff);
  __m256i most = _mm256_setzero_si256();
  __m512d sums = _mm512_setzero_pd();
  for (std::size_t k = 0; k < n; k += kAbreast) {
    __m256 row[kAbreast];  // NOLINT(modernize-avoid-c-arrays): registers
    for (std::size_t i = 0; i < kAbreast; ++i) {
      row[i] = _mm256_loadu_ps(rows + i * n + k);
    }
    if constexpr (kHasColumns) {
      __m512d column = _mm512_loadu_pd(columns + k);
      for (const __m256& of_row : row) {
        const __m512d wide = _mm512_maskz_cvtps_pd(kAll, of_row);
        column = _mm512_add_pd(column, _mm512_mul_pd(wide, wide));
        most = _mm256_max_epi32(most, _mm256_and_si256(_mm256_castps_si256(of_row), no_sign));
      }
      _mm512_storeu_pd(columns + k, column);
    }
    if constexpr (kHasRows) {
      __m256 pair[kAbreast];  // NOLINT(modernize-avoid-c-arrays): registers
      for (std::size_t i = 0; i < kAbreast; i += 2) {
        pair[i] = _mm256_unpacklo_ps(row[i], row[i + 1]);
        pair[i + 1] = _mm256_unpackhi_ps(row[i], row[i + 1]);
      }
      for (std::size_t half = 0; half < 2; ++half) {  // lights 0 to 3, and 4 to 7
        for (std::size_t j = 0; j < 4; ++j) {
          const std::size_t of = j / 2;
          const __m256 first = j % 2 == 0 ? _mm256_shuffle_ps(pair[of], pair[of + 2], 0x44)
                                          : _mm256_shuffle_ps(pair[of], pair[of + 2], 0xee);
          const __m256 last = j % 2 == 0 ? _mm256_shuffle_ps(pair[of + 4], pair[of + 6], 0x44)
                                         : _mm256_shuffle_ps(pair[of + 4], pair[of + 6], 0xee);
          const __m512d wide = _mm512_maskz_cvtps_pd(
              kAll, half == 0 ? _mm256_permute2f128_ps(first, last, 0x20)
                              : _mm256_permute2f128_ps(first, last, 0x31));
          sums = _mm512_add_pd(sums, _mm512_mul_pd(wide, wide));
        }
      }
    }
  }
  if constexpr (kHasRows) {
    _mm512_storeu_pd(each, sums);
  }
  alignas(32) std::array<std::int32_t, kAbreast> lanes{};
  _mm256_store_si256(reinterpret_cast<__m256i*>(lanes.data()), most);
  return *std::max_element(lanes.begin(), lanes.end());
}

/// @param n  a multiple of 16
[[gnu::target(HAARLIGHT_AVX512)]] std::size_t find_nonzero_avx512(const std::int32_t* numbers,
                                                                  std::size_t n,
                                                                  std::uint32_t* at) {
  __m512i index = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const __m512i step = _mm512_set1_epi32(static_cast<int>(kBlock));
  std::size_t found = 0;
  for (std::size_t k = 0; k < n; k += kBlock) {
    const __m512i block = _mm512_loadu_si512(numbers + k);
    const __mmask16 is_set = _mm512_test_epi32_mask(block, block);
    _mm512_storeu_si512(at + found, _mm512_maskz_compress_epi32(is_set, index));
    found += static_cast<std::size_t>(std::popcount(static_cast<std::uint32_t>(is_set)));
    index = _mm512_add_epi32(index, step);
  }
  return found;
}
#endif

/// Eight rows by the fastest way. @return  whether there is one
bool are_summed(std::span<const float> rows, std::size_t n, double* sums) {
#if defined(__x86_64__)
  if (n % kAbreast == 0 && rows.size() == kAbreast * n && has_avx512(best_kernel_code())) {
    squares_avx512<false, true>(rows.data(), n, nullptr, sums);
    return true;
  }
#endif
  static_cast<void>(rows);
  static_cast<void>(n);
  static_cast<void>(sums);
  return false;
}
bool are_summed(std::span<const double> /*rows*/, std::size_t /*n*/, double* /*sums*/) {
  return false;
}

template <class Real>
void sum_rows(std::span<const Real> rows, std::span<double> sums) {
  HAARLIGHT_EXPECTS(!sums.empty() && rows.size() % sums.size() == 0, "rows of equal length");
  const std::size_t n = rows.size() / sums.size();
  std::size_t i = 0;
  for (; i + kAbreast <= sums.size(); i += kAbreast) {
    if (!are_summed(rows.subspan(i * n, kAbreast * n), n, sums.data() + i)) {
      run_by_kernel<SumEight>(rows.data() + i * n, n, sums.data() + i);
    }
  }
  for (; i < sums.size(); ++i) {
    sums[i] = 0.0;
    for (const Real v : rows.subspan(i * n, n)) {
      sums[i] += double{v} * double{v};
    }
  }
}

struct QuantiseAll {
  template <class Real>
  [[gnu::always_inline]] static inline void run(Real step, Real inverse, std::size_t n,
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
};

struct SubtractScaled {
  template <class Real>
  [[gnu::always_inline]] static inline void run(const float* __restrict t, Real gain,
                                                const Real* __restrict direction, std::size_t n,
                                                Real* __restrict out) {
    for (std::size_t k = 0; k < n; ++k) {
      out[k] = static_cast<Real>(t[k]) - gain * direction[k];
    }
  }
};

/// NaN where either is.
template <class Real>
Real larger(Real a, Real b) {
  return b <= a || std::isnan(a) ? a : b;
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

float add_squares(std::span<const float> rows, std::size_t n_rows, double* sums) {
  HAARLIGHT_EXPECTS(n_rows > 0 && rows.size() % n_rows == 0, "rows of equal length");
  const std::size_t n = rows.size() / n_rows;
#if defined(__x86_64__)
  if (n_rows == kAbreast && n % kAbreast == 0 && has_avx512(best_kernel_code())) {
    return std::bit_cast<float>(squares_avx512<true, false>(rows.data(), n, sums, nullptr));
  }
#endif
  float largest = 0.0F;
  for (std::size_t i = 0; i < n_rows; ++i) {
    largest = larger(largest, run_by_kernel<AddSquares>(rows.data() + i * n, n, sums));
  }
  return largest;
}
double add_squares(std::span<const double> rows, std::size_t n_rows, double* sums) {
  HAARLIGHT_EXPECTS(n_rows > 0 && rows.size() % n_rows == 0, "rows of equal length");
  const std::size_t n = rows.size() / n_rows;
  double largest = 0.0;
  for (std::size_t i = 0; i < n_rows; ++i) {
    largest = larger(largest, run_by_kernel<AddSquares>(rows.data() + i * n, n, sums));
  }
  return largest;
}

float add_squares(std::span<const float> rows, double* sums, std::span<double> each) {
  HAARLIGHT_EXPECTS(!each.empty() && rows.size() % each.size() == 0, "rows of equal length");
#if defined(__x86_64__)
  const std::size_t n = rows.size() / each.size();
  if (each.size() == kAbreast && n % kAbreast == 0 && has_avx512(best_kernel_code())) {
    return std::bit_cast<float>(squares_avx512<true, true>(rows.data(), n, sums, each.data()));
  }
#endif
  sum_squares(rows, each);
  return add_squares(rows, each.size(), sums);
}

void sum_squares(std::span<const float> rows, std::span<double> sums) {
  sum_rows<float>(rows, sums);
}
void sum_squares(std::span<const double> rows, std::span<double> sums) {
  sum_rows<double>(rows, sums);
}

void quantise_row(double step, std::span<float> row, std::int32_t* quanta, double* energies,
                  double* errors) {
  run_by_kernel<QuantiseAll>(static_cast<float>(step), static_cast<float>(1.0 / step),
                             row.size(), row.data(), quanta, energies, errors);
}
void quantise_row(double step, std::span<double> row, std::int32_t* quanta, double* energies,
                  double* errors) {
  run_by_kernel<QuantiseAll>(step, 1.0 / step, row.size(), row.data(), quanta, energies,
                             errors);
}

std::size_t find_nonzero(std::span<const std::int32_t> numbers, std::uint32_t* at) {
#if defined(__x86_64__)
  if (has_avx512(best_kernel_code()) && numbers.size() % kBlock == 0) {
    return find_nonzero_avx512(numbers.data(), numbers.size(), at);
  }
#endif
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
    run_by_kernel<SubtractScaled>(t.data(), g, direction.data(), t.size(), out);
  }
}
void subtract_plate(std::span<const float> t, double gain, std::span<const double> direction,
                    double* out) {
  if (gain == 0.0) {
    std::copy(t.begin(), t.end(), out);
  } else {
    run_by_kernel<SubtractScaled>(t.data(), gain, direction.data(), t.size(), out);
  }
}

}  // namespace haarlight::relight
