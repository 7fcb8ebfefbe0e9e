// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/fit_kernel.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "haarlight/core/error.h"
#include "relight/reflectance/fit/wide_vectors.h"

#if HAARLIGHT_FIT_X86
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

namespace portable {
#define HAARLIGHT_LANES 4
#include "relight/reflectance/fit/fit_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace portable

#if HAARLIGHT_FIT_X86
namespace avx2 {
#define HAARLIGHT_LANES 8
#include "relight/reflectance/fit/fit_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace avx2

namespace avx512 {
#define HAARLIGHT_LANES 16
#include "relight/reflectance/fit/fit_loops.inc"
#undef HAARLIGHT_LANES
}  // namespace avx512
#endif

template <class T>
using Multiply = void (*)(const float* threes, std::size_t n_three, std::size_t n_in,
                          const T* in, std::size_t in_stride, std::size_t n, float* out,
                          std::size_t out_stride);

template <class T>
Multiply<T> choose_multiply() {
  switch (vector_width()) {
#if HAARLIGHT_FIT_X86
    case VectorWidth::avx512:
      return avx512::multiply<T>;
    case VectorWidth::avx2:
      return avx2::multiply<T>;
#endif
    default:
      return portable::multiply<T>;
  }
}

HAARLIGHT_WIDER void split(const std::uint16_t* __restrict codes, std::size_t n_pixels,
                           float* __restrict r, float* __restrict g, float* __restrict b) {
  constexpr float kWhite = 1.0F / 65535.0F;
  for (std::size_t i = 0; i < n_pixels; ++i) {
    r[i] = kWhite * static_cast<float>(codes[3 * i]);
    g[i] = kWhite * static_cast<float>(codes[3 * i + 1]);
    b[i] = kWhite * static_cast<float>(codes[3 * i + 2]);
  }
}

}  // namespace

FitMatrix::FitMatrix(const Eigen::MatrixXd& matrix)
    : n_out_(static_cast<std::size_t>(matrix.rows())),
      n_in_(static_cast<std::size_t>(matrix.cols())),
      threes_(fit_rows_padded(n_out_) * n_in_) {
  for (std::size_t o = 0; o < n_out_; ++o) {
    for (std::size_t i = 0; i < n_in_; ++i) {
      threes_[(o / 3 * n_in_ + i) * 3 + o % 3] = static_cast<float>(
          matrix(static_cast<Eigen::Index>(o), static_cast<Eigen::Index>(i)));
    }
  }
}

void FitMatrix::multiply(const float* in, std::size_t in_stride, std::size_t n, float* out,
                         std::size_t out_stride) const {
  HAARLIGHT_EXPECTS(n % kFitLanes == 0, "whole vectors");
  choose_multiply<float>()(threes_.data(), fit_rows_padded(n_out_) / 3, n_in_, in, in_stride, n,
                           out, out_stride);
}

void FitMatrix::multiply(const std::uint16_t* in, std::size_t in_stride, std::size_t n,
                         float* out, std::size_t out_stride) const {
  HAARLIGHT_EXPECTS(n % kFitLanes == 0, "whole vectors");
  choose_multiply<std::uint16_t>()(threes_.data(), fit_rows_padded(n_out_) / 3, n_in_, in,
                                   in_stride, n, out, out_stride);
}

void split_codes(const std::uint16_t* codes, std::size_t n_pixels, float* r, float* g,
                 float* b) {
  split(codes, n_pixels, r, g, b);
}

}  // namespace haarlight::relight
