#include "relight/fit/fit_kernel.h"

#include <algorithm>
#include <array>
#include <cstring>

#include "core/error.h"

// Vectors are written out for each width: generic ones are taken apart before target_clones
// makes its copies.
#if defined(__x86_64__)
#define HAARLIGHT_FIT_X86 1
#else
#define HAARLIGHT_FIT_X86 0
#endif

// Without contraction every width gives the same bits.
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define HAARLIGHT_WIDER [[gnu::target_clones("arch=skylake-avx512", "avx2", "default")]]
#else
#define HAARLIGHT_WIDER
#endif

namespace haarlight {

namespace {

/// Eight pixels of one row at a time: for machines without wide vectors.
void multiply_portable(const float* fours, std::size_t n_four, std::size_t n_in,
                       const float* in, std::size_t in_stride, std::size_t n, float* out,
                       std::size_t out_stride) {
  constexpr std::size_t kLanes = 8;
  for (std::size_t x = 0; x < n; x += kLanes) {
    for (std::size_t o = 0; o < 4 * n_four; ++o) {
      const float* m = fours + o / 4 * n_in * 4 + o % 4;
      std::array<float, kLanes> sum{};
      for (std::size_t i = 0; i < n_in; ++i) {
        for (std::size_t k = 0; k < kLanes; ++k) {
          sum[k] += m[4 * i] * in[i * in_stride + x + k];
        }
      }
      std::copy(sum.begin(), sum.end(), out + o * out_stride + x);
    }
  }
}

#if HAARLIGHT_FIT_X86
/// The same over two vectors of 8 pixels.
[[gnu::target("avx2")]] void multiply_avx2(const float* fours, std::size_t n_four,
                                           std::size_t n_in, const float* in,
                                           std::size_t in_stride, std::size_t n, float* out,
                                           std::size_t out_stride) {
  using Lanes = float __attribute__((vector_size(8 * sizeof(float))));
  constexpr std::size_t kLanes = 8;
  for (std::size_t x = 0; x < n; x += 2 * kLanes) {
    for (std::size_t f = 0; f < n_four; ++f) {
      const float* m = fours + f * n_in * 4;
      Lanes a0{};
      Lanes a1{};
      Lanes a2{};
      Lanes a3{};
      Lanes b0{};
      Lanes b1{};
      Lanes b2{};
      Lanes b3{};
      const float* v = in + x;
      for (std::size_t i = 0; i < n_in; ++i, v += in_stride, m += 4) {
        Lanes left;
        Lanes right;
        std::memcpy(&left, v, sizeof left);
        std::memcpy(&right, v + kLanes, sizeof right);
        a0 += m[0] * left;
        b0 += m[0] * right;
        a1 += m[1] * left;
        b1 += m[1] * right;
        a2 += m[2] * left;
        b2 += m[2] * right;
        a3 += m[3] * left;
        b3 += m[3] * right;
      }
      float* row = out + 4 * f * out_stride + x;
      std::memcpy(row, &a0, sizeof a0);
      std::memcpy(row + kLanes, &b0, sizeof b0);
      std::memcpy(row + out_stride, &a1, sizeof a1);
      std::memcpy(row + out_stride + kLanes, &b1, sizeof b1);
      std::memcpy(row + 2 * out_stride, &a2, sizeof a2);
      std::memcpy(row + 2 * out_stride + kLanes, &b2, sizeof b2);
      std::memcpy(row + 3 * out_stride, &a3, sizeof a3);
      std::memcpy(row + 3 * out_stride + kLanes, &b3, sizeof b3);
    }
  }
}
#endif

#if HAARLIGHT_FIT_X86
/// The same over two vectors of 16 pixels.
[[gnu::target("avx512f")]] void multiply_avx512(const float* fours, std::size_t n_four,
                                                std::size_t n_in, const float* in,
                                                std::size_t in_stride, std::size_t n,
                                                float* out, std::size_t out_stride) {
  using Lanes = float __attribute__((vector_size(16 * sizeof(float))));
  constexpr std::size_t kLanes = 16;
  for (std::size_t x = 0; x < n; x += 2 * kLanes) {
    for (std::size_t f = 0; f < n_four; ++f) {
      const float* m = fours + f * n_in * 4;
      Lanes a0{};
      Lanes a1{};
      Lanes a2{};
      Lanes a3{};
      Lanes b0{};
      Lanes b1{};
      Lanes b2{};
      Lanes b3{};
      const float* v = in + x;
      for (std::size_t i = 0; i < n_in; ++i, v += in_stride, m += 4) {
        Lanes left;
        Lanes right;
        std::memcpy(&left, v, sizeof left);
        std::memcpy(&right, v + kLanes, sizeof right);
        a0 += m[0] * left;
        b0 += m[0] * right;
        a1 += m[1] * left;
        b1 += m[1] * right;
        a2 += m[2] * left;
        b2 += m[2] * right;
        a3 += m[3] * left;
        b3 += m[3] * right;
      }
      float* row = out + 4 * f * out_stride + x;
      std::memcpy(row, &a0, sizeof a0);
      std::memcpy(row + kLanes, &b0, sizeof b0);
      std::memcpy(row + out_stride, &a1, sizeof a1);
      std::memcpy(row + out_stride + kLanes, &b1, sizeof b1);
      std::memcpy(row + 2 * out_stride, &a2, sizeof a2);
      std::memcpy(row + 2 * out_stride + kLanes, &b2, sizeof b2);
      std::memcpy(row + 3 * out_stride, &a3, sizeof a3);
      std::memcpy(row + 3 * out_stride + kLanes, &b3, sizeof b3);
    }
  }
}
#endif

using Multiply = void (*)(const float* fours, std::size_t n_four, std::size_t n_in,
                          const float* in, std::size_t in_stride, std::size_t n, float* out,
                          std::size_t out_stride);

Multiply choose_multiply() {
#if HAARLIGHT_FIT_X86
  if (__builtin_cpu_supports("avx512f")) {
    return multiply_avx512;
  }
  if (__builtin_cpu_supports("avx2")) {
    return multiply_avx2;
  }
#endif
  return multiply_portable;
}

constexpr float kWhite = 1.0F / 65535.0F;

HAARLIGHT_WIDER void widen(const std::uint16_t* __restrict codes, std::size_t n,
                           float* __restrict values) {
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = kWhite * static_cast<float>(codes[i]);
  }
}

HAARLIGHT_WIDER void split(const std::uint16_t* __restrict codes, std::size_t n_pixels,
                           float* __restrict r, float* __restrict g, float* __restrict b) {
  for (std::size_t i = 0; i < n_pixels; ++i) {
    r[i] = kWhite * static_cast<float>(codes[3 * i]);
    g[i] = kWhite * static_cast<float>(codes[3 * i + 1]);
    b[i] = kWhite * static_cast<float>(codes[3 * i + 2]);
  }
}

HAARLIGHT_WIDER void blend_values(const float* a, const float* b, float t, float* out,
                                  std::size_t n) {
  for (std::size_t i = 0; i < n; ++i) {
    out[i] = a[i] + t * (b[i] - a[i]);
  }
}

}  // namespace

FitMatrix::FitMatrix(const Eigen::MatrixXd& matrix)
    : n_out_(static_cast<std::size_t>(matrix.rows())),
      n_in_(static_cast<std::size_t>(matrix.cols())),
      fours_(fit_rows_padded(n_out_) * n_in_) {
  for (std::size_t o = 0; o < n_out_; ++o) {
    for (std::size_t i = 0; i < n_in_; ++i) {
      fours_[(o / 4 * n_in_ + i) * 4 + o % 4] = static_cast<float>(
          matrix(static_cast<Eigen::Index>(o), static_cast<Eigen::Index>(i)));
    }
  }
}

FitMatrix::FitMatrix(std::size_t n_out, std::size_t n_in)
    : n_out_(n_out), n_in_(n_in), fours_(fit_rows_padded(n_out) * n_in) {}

void FitMatrix::blend(const FitMatrix& a, const FitMatrix& b, float t) {
  HAARLIGHT_EXPECTS(a.fours_.size() == b.fours_.size() && a.n_in_ == b.n_in_,
                    "matrices of one shape");
  n_out_ = a.n_out_;
  n_in_ = a.n_in_;
  fours_.resize(a.fours_.size());
  blend_values(a.fours_.data(), b.fours_.data(), t, fours_.data(), fours_.size());
}

void FitMatrix::multiply(const float* in, std::size_t in_stride, std::size_t n, float* out,
                         std::size_t out_stride) const {
  HAARLIGHT_EXPECTS(n % kFitLanes == 0, "whole vectors");
  static const Multiply kMultiply = choose_multiply();
  kMultiply(fours_.data(), fit_rows_padded(n_out_) / 4, n_in_, in, in_stride, n, out,
            out_stride);
}

void widen_codes(const std::uint16_t* codes, std::size_t n, float* values) {
  widen(codes, n, values);
}

void split_codes(const std::uint16_t* codes, std::size_t n_pixels, float* r, float* g,
                 float* b) {
  split(codes, n_pixels, r, g, b);
}

}  // namespace haarlight
