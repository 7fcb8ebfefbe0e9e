// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/error_gram.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Core>

#include "core/count.h"
#include "core/linear_algebra.h"
#include "core/random.h"
#include "haarlight/core/error.h"

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

constexpr std::size_t kPixelBatch = 16;
constexpr std::size_t kPad = kNumberLine;  // numbers of the widest vector register
constexpr std::size_t kHalfPad = 16;
constexpr std::size_t kNear = 8;    // rows that stay in the L1 cache while others stream by
constexpr std::size_t kPanel = 32;  // and in the L2 cache
constexpr std::size_t kMostPixels = 1024;

std::size_t triangle(std::size_t n) { return n * (n + 1) / 2; }

/// Some rows of whole numbers, each padded to a multiple of kPad; they begin at a cache line.
struct NumberRows {
  const std::int16_t* first = nullptr;
  std::size_t stride = 0;
  [[nodiscard]] const std::int16_t* row(std::size_t i) const { return first + i * stride; }
};

std::int32_t dot_portable(const std::int16_t* a, const std::int16_t* b, std::size_t n) {
  std::int32_t sum = 0;
  for (std::size_t p = 0; p < n; ++p) {
    sum += std::int32_t{a[p]} * std::int32_t{b[p]};
  }
  return sum;
}

/// Products of 4 x 4 rows; out[4 i + j].
void dots_portable(const NumberRows& a, const NumberRows& b, std::int32_t* out) {
  for (std::size_t i = 0; i < 4; ++i) {
    for (std::size_t j = 0; j < 4; ++j) {
      out[4 * i + j] = dot_portable(a.row(i), b.row(j), a.stride);
    }
  }
}

#if defined(__x86_64__)
/// The sum of each register's eight numbers.
[[gnu::target("avx2")]] void fold_avx2(const __m256i* sums, std::int32_t* out) {
  const __m256i first = _mm256_hadd_epi32(_mm256_hadd_epi32(sums[0], sums[1]),
                                          _mm256_hadd_epi32(sums[2], sums[3]));
  const __m256i last = _mm256_hadd_epi32(_mm256_hadd_epi32(sums[4], sums[5]),
                                         _mm256_hadd_epi32(sums[6], sums[7]));
  const __m256i lower = _mm256_permute2x128_si256(first, last, 0x20);
  const __m256i upper = _mm256_permute2x128_si256(first, last, 0x31);
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(out), _mm256_add_epi32(lower, upper));
}

/// Products of 4 x 2 rows: sixteen registers hold no more sums.
[[gnu::target("avx2")]] void half_avx2(const NumberRows& a, const NumberRows& b,
                                       std::int32_t* out) {
  __m256i sums[8];  // NOLINT(modernize-avoid-c-arrays): registers
  for (__m256i& sum : sums) {
    sum = _mm256_setzero_si256();
  }
  for (std::size_t p = 0; p < a.stride; p += kHalfPad) {
    const auto load = [p](const std::int16_t* row) __attribute__((target("avx2"))) {
      return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(row + p));
    };
    const __m256i b0 = load(b.row(0));
    const __m256i b1 = load(b.row(1));
    for (std::size_t i = 0; i < 4; ++i) {
      const __m256i ai = load(a.row(i));
      sums[2 * i] = _mm256_add_epi32(sums[2 * i], _mm256_madd_epi16(ai, b0));
      sums[2 * i + 1] = _mm256_add_epi32(sums[2 * i + 1], _mm256_madd_epi16(ai, b1));
    }
  }
  fold_avx2(sums, out);
}

[[gnu::target("avx2")]] void dots_avx2(const NumberRows& a, const NumberRows& b,
                                       std::int32_t* out) {
  for (std::size_t j = 0; j < 4; j += 2) {
    std::array<std::int32_t, 8> half{};
    half_avx2(a, {b.row(j), b.stride}, half.data());
    for (std::size_t i = 0; i < 4; ++i) {
      out[4 * i + j] = half[2 * i];
      out[4 * i + j + 1] = half[2 * i + 1];
    }
  }
}

/// Products of one row with four, sixteen partial sums each.
struct FourSums {
  __m512i first;
  __m512i second;
  __m512i third;
  __m512i fourth;
};

[[gnu::target("avx512f,avx512bw,avx512vnni"), gnu::always_inline]] inline void add_products(
    FourSums& sums, const std::int16_t* row, const FourSums& others) {
  const __m512i numbers = _mm512_load_si512(row);
  sums.first = _mm512_dpwssd_epi32(sums.first, numbers, others.first);
  sums.second = _mm512_dpwssd_epi32(sums.second, numbers, others.second);
  sums.third = _mm512_dpwssd_epi32(sums.third, numbers, others.third);
  sums.fourth = _mm512_dpwssd_epi32(sums.fourth, numbers, others.fourth);
}

[[gnu::target("avx512f"), gnu::always_inline]] inline __m256i half_of(__m512i sum) {
  alignas(64) std::array<std::int32_t, 16> each{};
  _mm512_store_si512(each.data(), sum);
  const auto* from = reinterpret_cast<const __m256i*>(each.data());
  return _mm256_add_epi32(_mm256_load_si256(from), _mm256_load_si256(from + 1));
}

/// The sums of each register's sixteen numbers.
[[gnu::target("avx512f,avx512bw,avx512vnni")]] void fold_vnni(const FourSums& sums,
                                                              std::int32_t* out) {
  const __m256i all =
      _mm256_hadd_epi32(_mm256_hadd_epi32(half_of(sums.first), half_of(sums.second)),
                        _mm256_hadd_epi32(half_of(sums.third), half_of(sums.fourth)));
  _mm_storeu_si128(
      reinterpret_cast<__m128i*>(out),
      _mm_add_epi32(_mm256_castsi256_si128(all), _mm256_extracti128_si256(all, 1)));
}

/// Products of 4 x 4 rows: eight loads to sixteen multiplications, of which a processor of two
/// of each per cycle waits for the latter. GCC 12 would copy every sum twice per step.
[[gnu::target("avx512f,avx512bw,avx512vnni")]]
#if !defined(__clang__)
[[gnu::optimize("no-tree-coalesce-vars")]]
#endif
void dots_vnni(const NumberRows& a, const NumberRows& b, std::int32_t* out) {
  const __m512i zero = _mm512_setzero_si512();
  FourSums first{zero, zero, zero, zero};
  FourSums second = first;
  FourSums third = first;
  FourSums fourth = first;
  for (std::size_t p = 0; p < a.stride; p += kPad) {
    const FourSums others{_mm512_load_si512(b.row(0) + p), _mm512_load_si512(b.row(1) + p),
                          _mm512_load_si512(b.row(2) + p), _mm512_load_si512(b.row(3) + p)};
    add_products(first, a.row(0) + p, others);
    add_products(second, a.row(1) + p, others);
    add_products(third, a.row(2) + p, others);
    add_products(fourth, a.row(3) + p, others);
  }
  fold_vnni(first, out);
  fold_vnni(second, out + 4);
  fold_vnni(third, out + 8);
  fold_vnni(fourth, out + 12);
}

bool machine_has_vnni() {
  static const bool kHas = __builtin_cpu_supports("avx512vnni") != 0;
  return kHas;
}
#endif

void dots(KernelCode code, const NumberRows& a, const NumberRows& b, std::int32_t* out) {
#if defined(__x86_64__)
  if (code != KernelCode::portable) {
    (has_avx512(code) && machine_has_vnni() ? dots_vnni : dots_avx2)(a, b, out);
    return;
  }
#endif
  static_cast<void>(code);
  dots_portable(a, b, out);
}

/// Errors as whole numbers, ties to even. @return  the largest rounding error, in steps
template <class Real>
Real to_whole_portable(std::span<const Real> errors, Real inverse_scale, std::int16_t* to) {
  constexpr auto kMost = static_cast<Real>(kGramLargest);
  auto worst = Real(0);
  for (std::size_t k = 0; k < errors.size(); ++k) {
    const Real steps = errors[k] * inverse_scale;
    const Real whole = std::nearbyint(std::min(std::max(steps, -kMost), kMost));
    worst = std::max(worst, std::abs(steps - whole));
    to[k] = static_cast<std::int16_t>(whole);
  }
  return worst;
}

#if defined(__x86_64__)
[[gnu::target("avx2")]] float to_whole_avx2(std::span<const float> errors, float inverse_scale,
                                            std::int16_t* to) {
  constexpr std::size_t kLanes = 8;
  const __m256 scale = _mm256_set1_ps(inverse_scale);
  const __m256 most = _mm256_set1_ps(static_cast<float>(kGramLargest));
  const __m256 least = _mm256_set1_ps(static_cast<float>(-kGramLargest));
  const __m256 no_sign = _mm256_castsi256_ps(_mm256_set1_epi32(0x7fffffff));
  __m256 worst = _mm256_setzero_ps();
  std::size_t k = 0;
  for (; k + kLanes <= errors.size(); k += kLanes) {
    const __m256 steps = _mm256_mul_ps(_mm256_loadu_ps(errors.data() + k), scale);
    const __m256i whole = _mm256_cvtps_epi32(_mm256_min_ps(_mm256_max_ps(steps, least), most));
    const __m256 rest = _mm256_sub_ps(steps, _mm256_cvtepi32_ps(whole));
    worst = _mm256_max_ps(worst, _mm256_and_ps(rest, no_sign));
    const __m128i packed =
        _mm_packs_epi32(_mm256_castsi256_si128(whole), _mm256_extracti128_si256(whole, 1));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(to + k), packed);
  }
  std::array<float, kLanes> each{};
  _mm256_storeu_ps(each.data(), worst);
  return std::max(*std::max_element(each.begin(), each.end()),
                  to_whole_portable(errors.subspan(k), inverse_scale, to + k));
}
#endif

float to_whole(std::span<const float> errors, float inverse_scale, std::int16_t* to) {
#if defined(__x86_64__)
  if (best_kernel_code() != KernelCode::portable) {
    return to_whole_avx2(errors, inverse_scale, to);
  }
#endif
  return to_whole_portable(errors, inverse_scale, to);
}
double to_whole(std::span<const double> errors, double inverse_scale, std::int16_t* to) {
  return to_whole_portable(errors, inverse_scale, to);
}

/// The lower triangle of rows times rows; `n` of them, followed by zeros up to a multiple of 4.
void multiply_block(KernelCode code, const NumberRows& rows, std::size_t n, std::int32_t* out) {
  std::array<std::int32_t, 16> products{};  // of 4 x 4 rows
  const auto four_rows = [&](std::size_t i, std::size_t j_begin, std::size_t j_end) {
    for (std::size_t j = j_begin; j < j_end; j += 4) {
      dots(code, {rows.row(i), rows.stride}, {rows.row(j), rows.stride}, products.data());
      for (std::size_t r = i; r < std::min(i + 4, n); ++r) {
        const std::size_t end = std::min(j + 4, r + 1);
        std::copy_n(products.begin() + static_cast<std::ptrdiff_t>(4 * (r - i)),
                    end > j ? end - j : 0, out + triangle(r) + j);
      }
    }
  };
  for (std::size_t panel = 0; panel < n; panel += kPanel) {
    const std::size_t panel_end = std::min(n, panel + kPanel);
    for (std::size_t j = 0; j < panel_end; j += kNear) {
      for (std::size_t i = std::max(panel, j); i < panel_end; i += 4) {
        four_rows(i, j, std::min({j + kNear, i + 4, n}));
      }
    }
  }
}

using Matrix = Eigen::MatrixXd;

/// Products of the pictures normalised to length 1.
Matrix correlations(std::span<const double> products, std::span<const float> norms) {
  const auto n = static_cast<Eigen::Index>(norms.size());
  Eigen::VectorXd inverse(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const double norm = norms[static_cast<std::size_t>(i)];
    inverse[i] = norm > 0.0 ? 1.0 / norm : 0.0;
  }
  Matrix all(n, n);
  std::size_t from = 0;
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j <= i; ++j, ++from) {
      all(i, j) = products[from] * inverse[i] * inverse[j];
      all(j, i) = all(i, j);
    }
  }
  return all;
}

/// The largest eigenvalues and vectors, ascending, from a block Krylov space [Halko11, 4.5].
/// Their accuracy affects only how sharp the bound becomes: at twice the depth the bound on the
/// rest was 0 to 2 % lower (two captures of the demo and a synthetic stack, 32 vectors).
struct TopVectors {
  Eigen::VectorXd values;
  Matrix vectors;
};
TopVectors top_vectors(const Matrix& all, Eigen::Index wanted) {
  constexpr Eigen::Index kBlock = 16;
  constexpr Eigen::Index kLeastDepth = 6;
  const Eigen::Index n = all.rows();
  const Eigen::Index size =
      std::min(n, kBlock * std::max(kLeastDepth, (4 * wanted + kBlock - 1) / kBlock));
  Matrix basis(n, size);
  Matrix image(n, size);
  Matrix next(n, std::min(kBlock, size));
  for (Eigen::Index j = 0; j < next.cols(); ++j) {
    for (Eigen::Index i = 0; i < n; ++i) {
      next(i, j) = standard_normal(
          hash_key(0x6772616d, static_cast<std::uint64_t>(i), static_cast<std::uint64_t>(j)));
    }
  }
  for (Eigen::Index done = 0; done < size; done += kBlock) {
    const Eigen::Index width = std::min(kBlock, size - done);
    next = orthonormal_columns(next.leftCols(width));
    for (int pass = 0; pass < 2 && done > 0; ++pass) {  // twice: once leaves rounding errors
      const auto before = basis.leftCols(done);
      const Matrix along = before.transpose() * next;
      next.noalias() -= before * along;
      next = orthonormal_columns(next);
    }
    basis.middleCols(done, width) = next;
    image.middleCols(done, width).noalias() = all * next;
    next = image.middleCols(done, width);
  }
  const SymmetricEigen small = symmetric_eigen(basis.transpose() * image);
  return {small.values, basis * small.vectors};
}

/// An estimate of the largest eigenvalue, from below.
double largest_eigenvalue(const Matrix& all) {
  constexpr int kPasses = 40;
  Eigen::VectorXd v(all.rows());
  for (Eigen::Index i = 0; i < v.size(); ++i) {
    v[i] = standard_normal(hash_key(0x7265737400, static_cast<std::uint64_t>(i)));
  }
  double found = 0.0;
  for (int pass = 0; pass < kPasses; ++pass) {
    const double norm = v.norm();
    if (!(norm > 0.0)) {
      return 0.0;
    }
    v /= norm;
    const Eigen::VectorXd image = all * v;
    found = v.dot(image);
    v = image + std::abs(found) * v;  // the largest, not the largest in magnitude
  }
  return std::max(found, 0.0);
}

/// A bound above all eigenvalues (`fraction`): fraction I - rest has a Cholesky factor. Its
/// factorisation in doubles proves that to n^2 2^-53 of the bound (1e-10), below the margin
/// added.
double proven_bound(const Matrix& rest) {
  constexpr double kMargin = 1.003;
  constexpr double kGrowth = 1.02;
  double fraction = kMargin * largest_eigenvalue(rest) + 1e-6;
  while (true) {
    Matrix shifted = -rest;
    shifted.diagonal().array() += fraction;
    if (Cholesky(shifted).is_positive_definite()) {
      return fraction * (1.0 + 1e-8);
    }
    fraction *= kGrowth;
  }
}

/// The step of a vector: its numbers are then 8-bit integers, two bytes of a float. Finer ones
/// cost a third byte: unrounded numbers make that bound at most 0.9 % lower (same data).
double step_of(double largest) {
  constexpr double kMostSteps = 255.0;
  return largest > 0.0 ? std::exp2(std::ceil(std::log2(largest / kMostSteps))) : 1.0;
}

float round_up(double v) {
  const auto f = static_cast<float>(v);
  return double{f} < v ? std::nextafter(f, std::numeric_limits<float>::infinity()) : f;
}

}  // namespace

int n_gram_blocks(int n_lights) { return (n_lights + kGramBlock - 1) / kGramBlock; }

std::size_t gram_size(int n_lights) {
  std::size_t size = 0;
  for (int begin = 0; begin < n_lights; begin += kGramBlock) {
    size += triangle(count(std::min(kGramBlock, n_lights - begin)));
  }
  return size;
}

TileErrors::TileErrors(std::span<const int> indices, std::size_t n_pixels)
    : indices_(indices), n_pixels_(n_pixels), stride_((n_pixels + kPad - 1) / kPad * kPad) {
  HAARLIGHT_EXPECTS(n_pixels <= kMostPixels, "sums of a tile fit 32 bits");
  // Three rows of zeros: blocks of rows are multiplied four by four.
  rows_.resize((indices.size() + 3) * stride_ / kPad);
  batch_.resize(kPixelBatch * indices.size());
}

template <class Real>
void TileErrors::append_row(std::span<const Real> errors, Real inverse_scale) {
  HAARLIGHT_EXPECTS(errors.size() == indices_.size() && n_done_ + n_batch_ < n_pixels_,
                    "a pixel of the tile");
  const Real worst =
      to_whole(errors, inverse_scale, batch_.data() + n_batch_ * indices_.size());
  largest_rest_ = std::max(largest_rest_, double{worst});
  if (++n_batch_ == kPixelBatch || n_done_ + n_batch_ == n_pixels_) {
    transpose();
  }
}

void TileErrors::append(std::span<const float> errors, double inverse_scale) {
  append_row(errors, static_cast<float>(inverse_scale));
}
void TileErrors::append(std::span<const double> errors, double inverse_scale) {
  append_row(errors, inverse_scale);
}

void TileErrors::transpose() {
  const std::size_t n = indices_.size();
  for (std::size_t k = 0; k < n; ++k) {
    std::int16_t* to = rows_.front().numbers.data() + count(indices_[k]) * stride_ + n_done_;
    for (std::size_t p = 0; p < n_batch_; ++p) {
      to[p] = batch_[p * n + k];
    }
  }
  n_done_ += n_batch_;
  n_batch_ = 0;
}

std::vector<std::int32_t> TileErrors::products(KernelCode code) {
  HAARLIGHT_EXPECTS(n_done_ == n_pixels_, "every pixel of the tile");
  const auto n_lights = static_cast<int>(indices_.size());
  std::vector<std::int32_t> out(gram_size(n_lights));
  std::size_t at = 0;
  for (int begin = 0; begin < n_lights; begin += kGramBlock) {
    const std::size_t n = count(std::min(kGramBlock, n_lights - begin));
    multiply_block(code, {rows_.front().numbers.data() + count(begin) * stride_, stride_}, n,
                   out.data() + at);
    at += triangle(n);
  }
  return out;
}

SparseProducts::SparseProducts(int n_lights) : products_(gram_size(n_lights)) {}

void SparseProducts::add(std::span<const int> indices, std::span<const double> values) {
  HAARLIGHT_EXPECTS(indices.size() == values.size(), "one value per index");
  const std::size_t per_block = triangle(kGramBlock);
  for (std::size_t first = 0; first < indices.size();) {
    const int block = indices[first] / kGramBlock;
    std::size_t end = first;
    for (; end < indices.size() && indices[end] / kGramBlock == block; ++end) {
      double* row = products_.data() + count(block) * per_block +
                    triangle(count(indices[end] - block * kGramBlock));
      for (std::size_t j = first; j <= end; ++j) {
        row[indices[j] - block * kGramBlock] += values[end] * values[j];
      }
    }
    first = end;
  }
}

ProductBound fit_product_bound(std::span<const double> products, std::span<const float> norms,
                               int n_vectors) {
  constexpr Eigen::Index kSpare = 8;
  HAARLIGHT_EXPECTS(products.size() == triangle(norms.size()), "a lower triangle");
  HAARLIGHT_EXPECTS(n_vectors >= 0 && count(n_vectors) <= norms.size(), "some vectors");
  const auto n = static_cast<Eigen::Index>(norms.size());
  Matrix rest = correlations(products, norms);
  ProductBound bound;
  if (n_vectors > 0) {
    const TopVectors top = top_vectors(rest, n_vectors + kSpare);
    const Eigen::Index last = top.values.size() - 1;
    const double left = n_vectors > last ? 0.0 : std::max(top.values[last - n_vectors], 0.0);
    Matrix kept(n, n_vectors);
    for (int j = 0; j < n_vectors; ++j) {
      const double length = std::sqrt(std::max(top.values[last - j] - left, 0.0));
      const Eigen::VectorXd exact = length * top.vectors.col(last - j);
      const double step = step_of(exact.lpNorm<Eigen::Infinity>());
      for (Eigen::Index i = 0; i < n; ++i) {
        kept(i, j) = step * std::nearbyint(exact[i] / step);
        bound.vectors.push_back(static_cast<float>(kept(i, j)));
      }
    }
    rest.noalias() -= kept * kept.transpose();
  }
  // Each product may be off by 2^-23 of the norms, n of them per row; and a norm by as much.
  bound.fraction = round_up(proven_bound(rest) + 0x1p-23 * static_cast<double>(n + 8));
  return bound;
}

}  // namespace haarlight::relight
