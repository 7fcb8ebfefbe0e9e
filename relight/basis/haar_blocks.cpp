// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/haar_blocks.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <type_traits>
#include <utility>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "haarlight/relight/basis/haar.h"
#include "relight/basis/relight_kernels.h"

namespace haarlight::relight {

namespace {

using Index = std::ptrdiff_t;

constexpr int kLargest = 64;  // two arrays of doubles fill half of the L2 cache
constexpr std::size_t kGrainValues = std::size_t{1} << 18U;

template <class T>
using Scratch = std::array<T, std::size_t{kLargest} * kLargest>;

#if defined(__x86_64__)

/// Sixteen values as the eight at even and the eight at odd indices.
struct Halves {
  __m256 even;
  __m256 odd;
};

[[gnu::target("avx2")]] inline Halves split(const float* x) {
  const __m256 a = _mm256_loadu_ps(x);
  const __m256 b = _mm256_loadu_ps(x + 8);
  const __m256d even = _mm256_castps_pd(_mm256_shuffle_ps(a, b, 0x88));
  const __m256d odd = _mm256_castps_pd(_mm256_shuffle_ps(a, b, 0xdd));
  return {_mm256_castpd_ps(_mm256_permute4x64_pd(even, 0xd8)),
          _mm256_castpd_ps(_mm256_permute4x64_pd(odd, 0xd8))};
}

[[gnu::target("avx2")]] inline void join(const Halves& halves, float* x) {
  const __m256 low = _mm256_unpacklo_ps(halves.even, halves.odd);
  const __m256 high = _mm256_unpackhi_ps(halves.even, halves.odd);
  _mm256_storeu_ps(x, _mm256_permute2f128_ps(low, high, 0x20));
  _mm256_storeu_ps(x + 8, _mm256_permute2f128_ps(low, high, 0x31));
}

#endif

/// One level of x, m x m with rows `stride` apart: LL to `ll` (rows m/2 apart), the details to
/// their positions in `out`, n x n. haar.cpp's forward_level, operation by operation.
template <class T>
[[gnu::always_inline]] inline void forward_level(const T* __restrict x, Index stride, Index m,
                                                 T* __restrict ll, T* __restrict out, Index n) {
  const Index h = m / 2;
  for (Index i = 0; i < h; ++i) {
    const T* __restrict top = x + 2 * i * stride;
    const T* __restrict bottom = top + stride;
    T* __restrict to_ll = ll + i * h;
    T* __restrict to_x = out + i * n + h;
    T* __restrict to_y = out + (i + h) * n;
    T* __restrict to_d = to_y + h;
    for (Index j = 0; j < h; ++j) {
      const T sum_top = top[2 * j] + top[2 * j + 1];
      const T sum_bottom = bottom[2 * j] + bottom[2 * j + 1];
      const T difference_top = top[2 * j] - top[2 * j + 1];
      const T difference_bottom = bottom[2 * j] - bottom[2 * j + 1];
      to_ll[j] = (sum_top + sum_bottom) * T(0.5);
      to_x[j] = (difference_top + difference_bottom) * T(0.5);
      to_y[j] = (sum_top - sum_bottom) * T(0.5);
      to_d[j] = (difference_top - difference_bottom) * T(0.5);
    }
  }
}

/// The inverse: LL of m/2 x m/2 (rows `ll_stride` apart) and the details in x, n x n, to m x m
/// values in `out`, rows m apart.
template <class T>
[[gnu::always_inline]] inline void inverse_level(const T* __restrict ll, Index ll_stride,
                                                 const T* __restrict x, Index n, Index m,
                                                 T* __restrict out) {
  const Index h = m / 2;
  for (Index i = 0; i < h; ++i) {
    const T* __restrict from_ll = ll + i * ll_stride;
    const T* __restrict from_x = x + i * n + h;
    const T* __restrict from_y = x + (i + h) * n;
    const T* __restrict from_d = from_y + h;
    T* __restrict top = out + 2 * i * m;
    T* __restrict bottom = top + m;
    for (Index j = 0; j < h; ++j) {
      const T sum_top = from_ll[j] + from_y[j];
      const T sum_bottom = from_ll[j] - from_y[j];
      const T difference_top = from_x[j] + from_d[j];
      const T difference_bottom = from_x[j] - from_d[j];
      top[2 * j] = (sum_top + difference_top) * T(0.5);
      top[2 * j + 1] = (sum_top - difference_top) * T(0.5);
      bottom[2 * j] = (sum_bottom + difference_bottom) * T(0.5);
      bottom[2 * j + 1] = (sum_bottom - difference_bottom) * T(0.5);
    }
  }
}

#if defined(__x86_64__)

/// forward_level for eight columns of blocks at a time: the same operations on each.
[[gnu::target("avx2")]] void forward_level_avx2(const float* x, Index stride, Index m,
                                                float* ll, float* out, Index n) {
  const Index h = m / 2;
  const __m256 half = _mm256_set1_ps(0.5F);
  for (Index i = 0; i < h; ++i) {
    const float* top = x + 2 * i * stride;
    const float* bottom = top + stride;
    float* to_ll = ll + i * h;
    float* to_x = out + i * n + h;
    float* to_y = out + (i + h) * n;
    float* to_d = to_y + h;
    for (Index j = 0; j < h; j += 8) {
      const Halves t = split(top + 2 * j);
      const Halves b = split(bottom + 2 * j);
      const __m256 sum_top = _mm256_add_ps(t.even, t.odd);
      const __m256 sum_bottom = _mm256_add_ps(b.even, b.odd);
      const __m256 difference_top = _mm256_sub_ps(t.even, t.odd);
      const __m256 difference_bottom = _mm256_sub_ps(b.even, b.odd);
      _mm256_storeu_ps(to_ll + j, _mm256_mul_ps(_mm256_add_ps(sum_top, sum_bottom), half));
      _mm256_storeu_ps(to_x + j,
                       _mm256_mul_ps(_mm256_add_ps(difference_top, difference_bottom), half));
      _mm256_storeu_ps(to_y + j, _mm256_mul_ps(_mm256_sub_ps(sum_top, sum_bottom), half));
      _mm256_storeu_ps(to_d + j,
                       _mm256_mul_ps(_mm256_sub_ps(difference_top, difference_bottom), half));
    }
  }
}

[[gnu::target("avx2")]] void inverse_level_avx2(const float* ll, Index ll_stride,
                                                const float* x, Index n, Index m, float* out) {
  const Index h = m / 2;
  const __m256 half = _mm256_set1_ps(0.5F);
  for (Index i = 0; i < h; ++i) {
    const float* from_ll = ll + i * ll_stride;
    const float* from_x = x + i * n + h;
    const float* from_y = x + (i + h) * n;
    const float* from_d = from_y + h;
    float* top = out + 2 * i * m;
    float* bottom = top + m;
    for (Index j = 0; j < h; j += 8) {
      const __m256 a = _mm256_loadu_ps(from_ll + j);
      const __m256 b = _mm256_loadu_ps(from_y + j);
      const __m256 c = _mm256_loadu_ps(from_x + j);
      const __m256 d = _mm256_loadu_ps(from_d + j);
      const __m256 sum_top = _mm256_add_ps(a, b);
      const __m256 sum_bottom = _mm256_sub_ps(a, b);
      const __m256 difference_top = _mm256_add_ps(c, d);
      const __m256 difference_bottom = _mm256_sub_ps(c, d);
      join({_mm256_mul_ps(_mm256_add_ps(sum_top, difference_top), half),
            _mm256_mul_ps(_mm256_sub_ps(sum_top, difference_top), half)},
           top + 2 * j);
      join({_mm256_mul_ps(_mm256_add_ps(sum_bottom, difference_bottom), half),
            _mm256_mul_ps(_mm256_sub_ps(sum_bottom, difference_bottom), half)},
           bottom + 2 * j);
    }
  }
}

#endif

/// How one level is run: plain loops, or vectors where they are wide enough.
enum class LevelCode { plain, avx2 };

template <LevelCode kCode, class T>
[[gnu::always_inline]] inline void forward_any(const T* x, Index stride, Index m, T* ll, T* out,
                                               Index n) {
#if defined(__x86_64__)
  if constexpr (kCode == LevelCode::avx2 && std::is_same_v<T, float>) {
    if (m >= 16) {
      forward_level_avx2(x, stride, m, ll, out, n);
      return;
    }
  }
#endif
  forward_level(x, stride, m, ll, out, n);
}

template <LevelCode kCode, class T>
[[gnu::always_inline]] inline void inverse_any(const T* ll, Index ll_stride, const T* x,
                                               Index n, Index m, T* out) {
#if defined(__x86_64__)
  if constexpr (kCode == LevelCode::avx2 && std::is_same_v<T, float>) {
    if (m >= 16) {
      inverse_level_avx2(ll, ll_stride, x, n, m, out);
      return;
    }
  }
#endif
  inverse_level(ll, ll_stride, x, n, m, out);
}

template <LevelCode kCode, class T>
[[gnu::always_inline]] inline void forward_array(const T* x, T* out, Index n, T* a, T* b) {
  forward_any<kCode>(x, n, n, a, out, n);
  for (Index m = n / 2; m > 1; m /= 2) {
    forward_any<kCode, T>(a, m, m, b, out, n);
    std::swap(a, b);
  }
  out[0] = a[0];
}

template <LevelCode kCode, class T>
[[gnu::always_inline]] inline void inverse_array(const T* x, T* out, Index n, T* a, T* b) {
  a[0] = x[0];
  for (Index m = 2; m < n; m *= 2) {
    inverse_any<kCode, T>(a, m / 2, x, n, m, b);
    std::swap(a, b);
  }
  inverse_any<kCode, T>(a, n / 2, x, n, n, out);
}

template <class T>
struct Blocks {
  T* values = nullptr;
  Index n = 0;
  bool is_forward = true;
};

template <LevelCode kCode, class T>
[[gnu::always_inline]] inline void transform(const Blocks<T>& blocks, std::size_t begin,
                                             std::size_t end) {
  alignas(64) Scratch<T> result;
  alignas(64) Scratch<T> a;
  alignas(64) Scratch<T> b;
  const auto size = static_cast<std::size_t>(blocks.n * blocks.n);
  for (std::size_t i = begin; i < end; ++i) {
    T* array = blocks.values + i * size;
    if (blocks.is_forward) {
      forward_array<kCode>(array, result.data(), blocks.n, a.data(), b.data());
    } else {
      inverse_array<kCode>(array, result.data(), blocks.n, a.data(), b.data());
    }
    std::copy_n(result.data(), size, array);
  }
}

#if defined(__x86_64__)
template <class T>
[[gnu::target("avx2")]] void transform_avx2(const Blocks<T>& blocks, std::size_t begin,
                                            std::size_t end) {
  transform<LevelCode::avx2>(blocks, begin, end);
}
#endif

template <class T>
void transform_all(std::span<T> values, const HaarGrid& grid, bool is_forward) {
  HAARLIGHT_EXPECTS(grid.is_valid(), "the Haar transform needs sides of 1 to 1024");
  const auto size = static_cast<std::size_t>(grid.size());
  HAARLIGHT_EXPECTS(values.size() % size == 0, "whole arrays");
  const std::size_t grain = std::max<std::size_t>(1, kGrainValues / size);
  const int n = grid.rows;
  if (!grid.is_plain() || n == 1 || n > kLargest) {
    parallel_for(values.size() / size, grain, [&](std::size_t begin, std::size_t end) {
      const std::span<T> arrays = values.subspan(begin * size, (end - begin) * size);
      is_forward ? haar_forward(arrays, grid) : haar_inverse(arrays, grid);
    });
    return;
  }
  const Blocks<T> blocks{values.data(), n, is_forward};
  parallel_for(values.size() / size, grain, [&](std::size_t begin, std::size_t end) {
#if defined(__x86_64__)
    if (best_kernel_code() != KernelCode::portable) {
      transform_avx2(blocks, begin, end);
      return;
    }
#endif
    transform<LevelCode::plain>(blocks, begin, end);
  });
}

}  // namespace

void haar_forward_blocks(std::span<float> values, const HaarGrid& grid) {
  transform_all(values, grid, true);
}
void haar_forward_blocks(std::span<double> values, const HaarGrid& grid) {
  transform_all(values, grid, true);
}
void haar_inverse_blocks(std::span<float> values, const HaarGrid& grid) {
  transform_all(values, grid, false);
}
void haar_inverse_blocks(std::span<double> values, const HaarGrid& grid) {
  transform_all(values, grid, false);
}

}  // namespace haarlight::relight
