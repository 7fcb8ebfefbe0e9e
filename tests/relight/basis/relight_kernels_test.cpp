// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/relight_kernels.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "relight/basis/half_float.h"

namespace haarlight::relight {
namespace {

std::vector<KernelCode> codes() {
  std::vector<KernelCode> all = {KernelCode::portable};
  if (best_kernel_code() != KernelCode::portable) {
    all.insert(all.end(), {KernelCode::avx2, KernelCode::avx2_gather});
  }
  return all;
}

float signed_unit(std::uint64_t a, std::uint64_t b) {
  return static_cast<float>(2.0 * uniform_unit(hash_key(a, b)) - 1.0);
}

std::vector<float> signed_units(std::uint64_t seed, std::size_t n) {
  std::vector<float> values(n);
  for (std::size_t i = 0; i < n; ++i) {
    values[i] = signed_unit(seed, i);
  }
  return values;
}

TEST(HalfFloat, EveryFiniteHalfComesBack) {
  for (std::uint32_t bits = 0; bits < 0x10000U; ++bits) {
    if ((bits & 0x7c00U) == 0x7c00U) {
      continue;  // infinities and NaN are refused before
    }
    const auto half = static_cast<std::uint16_t>(bits);
    // The definition: (-1)^s 2^(e - 25) (1024 + m), without the 1024 for e = 0.
    const int exponent = (half >> 10) & 31;
    const int mantissa = half & 1023;
    const double value =
        std::ldexp(exponent == 0 ? mantissa : 1024 + mantissa, std::max(exponent, 1) - 25) *
        ((half & 0x8000) != 0 ? -1.0 : 1.0);
    ASSERT_EQ(double{half_to_float(half)}, value) << bits;
    ASSERT_EQ(float_to_half(static_cast<float>(value)), half) << bits;
  }
}

TEST(HalfFloat, RoundsToTheNearestAndTiesToEven) {
  for (std::uint32_t bits = 0; bits < 0x7bffU; ++bits) {
    const auto below = static_cast<std::uint16_t>(bits);
    const auto above = static_cast<std::uint16_t>(bits + 1);
    const float low = half_to_float(below);
    const float high = half_to_float(above);
    const float middle = 0.5F * (low + high);  // exact: one bit more
    ASSERT_EQ(float_to_half(middle), (bits & 1U) == 0 ? below : above) << bits;
    ASSERT_EQ(float_to_half(std::nextafter(middle, low)), below) << bits;
    ASSERT_EQ(float_to_half(std::nextafter(middle, high)), above) << bits;
    ASSERT_EQ(float_to_half(-middle), 0x8000U | float_to_half(middle)) << bits;
  }
  EXPECT_EQ(float_to_half(65519.0F), 0x7bffU);  // still nearest to 65504
}

/// Rows of random halfs, lights padded with zeros.
struct Dense {
  Dense(std::size_t n_pixels, std::size_t n_lights)
      : stride((n_lights + kDenseLanes - 1) / kDenseLanes * kDenseLanes),
        halfs(n_pixels * stride),
        rows{halfs.data(), n_pixels, stride} {
    for (std::size_t p = 0; p < n_pixels; ++p) {
      for (std::size_t k = 0; k < n_lights; ++k) {
        halfs[p * stride + k] = float_to_half(1000.0F * signed_unit(p, k));
      }
    }
  }
  std::size_t stride;
  std::vector<std::uint16_t> halfs;
  DenseRows rows;
  [[nodiscard]] std::vector<LaneRange> all() const { return {{0, static_cast<int>(stride)}}; }
};

TEST(DenseKernel, IsTheSumToTheStatedBound) {
  const Dense dense(37, 1000);
  const std::vector<float> weights = [&] {
    std::vector<float> w = signed_units(5, dense.stride);
    std::fill(w.begin() + 1000, w.end(), 0.0F);
    return w;
  }();
  for (const KernelCode code : codes()) {
    std::vector<float> sums(37);
    sum_dense(code, dense.rows, dense.all(), weights, sums);
    for (std::size_t p = 0; p < sums.size(); ++p) {
      double sum = 0.0;
      double absolute = 0.0;
      for (std::size_t k = 0; k < dense.stride; ++k) {
        const double product =
            double{weights[k]} * double{half_to_float(dense.halfs[p * dense.stride + k])};
        sum += product;
        absolute += std::abs(product);
      }
      // 32 additions a lane, 5 of the fold, 1 product.
      EXPECT_NEAR(double{sums[p]}, sum, 38 * 0x1p-24 * absolute);
    }
  }
}

TEST(DenseKernel, GivesTheSameBitsWithAndWithoutAvx2AndInABatch) {
  if (best_kernel_code() == KernelCode::portable) {
    GTEST_SKIP() << "this machine has no AVX2";
  }
  const Dense dense(53, 1024);
  std::vector<float> batch(dense.stride * kBatch);
  std::vector<std::vector<float>> weights;
  for (std::size_t e = 0; e < kBatch; ++e) {
    weights.push_back(signed_units(e, dense.stride));
    for (std::size_t k = 0; k < dense.stride; ++k) {
      batch[(k / 8 * kBatch + e) * 8 + k % 8] = weights[e][k];
    }
  }
  std::vector<float> portable(dense.rows.n_pixels * kBatch);
  std::vector<float> vectors(portable.size());
  sum_dense_batch(KernelCode::portable, dense.rows, dense.all(), batch, portable);
  sum_dense_batch(KernelCode::avx2, dense.rows, dense.all(), batch, vectors);
  EXPECT_EQ(portable, vectors);
  for (std::size_t e = 0; e < kBatch; ++e) {
    for (const KernelCode code : codes()) {
      std::vector<float> single(dense.rows.n_pixels);
      sum_dense(code, dense.rows, dense.all(), weights[e], single);
      for (std::size_t p = 0; p < single.size(); ++p) {
        ASSERT_EQ(single[p], vectors[p * kBatch + e]);
      }
    }
  }
}

TEST(DenseKernel, LightsOutsideTheRangesAreNotRead) {
  Dense dense(3, 256);
  std::vector<float> weights(256, 0.0F);
  std::fill(weights.begin() + 64, weights.begin() + 96, 1.0F);
  const std::vector<LaneRange> lit = {{64, 96}};
  std::vector<float> all(3);
  std::vector<float> part(3);
  for (const KernelCode code : codes()) {
    sum_dense(code, dense.rows, dense.all(), weights, all);
    Dense poisoned = dense;
    for (std::size_t p = 0; p < 3; ++p) {
      for (std::size_t k = 0; k < 256; ++k) {
        if (k < 64 || k >= 96) {
          poisoned.halfs[p * 256 + k] = 0x7e00U;  // NaN
        }
      }
    }
    sum_dense(code, {poisoned.halfs.data(), 3, 256}, lit, weights, part);
    EXPECT_EQ(all, part);
  }
}

/// The same random coefficients as rows and as lists.
struct Sparse {
  explicit Sparse(std::uint64_t seed) {
    lists.resize(kIndices);
    std::vector<std::uint32_t> lengths(kPixels);
    for (std::size_t i = 0; i < kIndices; ++i) {
      for (std::size_t p = 0; p < kPixels; ++p) {
        // Some pixels none, some all.
        if (uniform_unit(hash_key(seed, i, p)) < static_cast<double>(p) / (kPixels - 9)) {
          lists[i].push_back({static_cast<std::uint16_t>(p),
                              static_cast<std::int16_t>(hash_key(seed, p, i, 1) & 0xffffU)});
          ++lengths[p];
        }
      }
    }
    for (std::size_t p = kPixels; p-- > 0;) {  // the longest last
      if (lengths[p] > 0) {
        pixels.push_back(static_cast<std::uint16_t>(p));
      }
    }
    std::stable_sort(pixels.begin(), pixels.end(),
                     [&](std::uint16_t a, std::uint16_t b) { return lengths[a] > lengths[b]; });
    starts.push_back(0);
    for (std::size_t slot = 0; slot * 8 < pixels.size(); ++slot) {
      starts.push_back(starts.back() + lengths[pixels[slot * 8]]);
    }
    blocks.resize(starts.back());
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      std::size_t next = starts[i / 8];
      for (std::size_t index = 0; index < kIndices; ++index) {
        for (const ListEntry& entry : lists[index]) {
          if (entry.pixel == pixels[i]) {
            blocks[next].index[i % 8] = static_cast<std::uint16_t>(index);
            blocks[next++].value[i % 8] = entry.value;
          }
        }
      }
    }
  }
  static constexpr std::size_t kPixels = 61;
  static constexpr std::size_t kIndices = 200;
  std::vector<std::vector<ListEntry>> lists;
  std::vector<std::uint16_t> pixels;
  std::vector<std::uint32_t> starts;
  std::vector<RowBlock> blocks;
  [[nodiscard]] SparseRows rows() const { return {pixels, starts, blocks}; }
};

TEST(SparseKernels, RowsListsAndBatchesGiveTheSameBits) {
  const Sparse sparse(3);
  const std::vector<float> light = signed_units(9, Sparse::kIndices * kBatch);
  std::vector<float> truth(Sparse::kPixels * kBatch);
  for (std::size_t e = 0; e < kBatch; ++e) {
    std::vector<float> own(Sparse::kIndices);
    for (std::size_t i = 0; i < own.size(); ++i) {
      own[i] = light[i * kBatch + e];
    }
    std::vector<float> by_lists(Sparse::kPixels);
    for (std::size_t i = 0; i < Sparse::kIndices; ++i) {
      add_list(sparse.lists[i], own[i], by_lists);
    }
    for (const KernelCode code : codes()) {
      std::vector<float> by_rows(Sparse::kPixels);
      sum_rows(code, sparse.rows(), own, by_rows);
      EXPECT_EQ(by_rows, by_lists);
    }
    for (std::size_t p = 0; p < Sparse::kPixels; ++p) {
      truth[p * kBatch + e] = by_lists[p];
    }
  }
  for (const KernelCode code : codes()) {
    std::vector<float> rows(truth.size());
    std::vector<float> lists(truth.size());
    sum_rows_batch(code, sparse.rows(), light, rows);
    for (std::size_t i = 0; i < Sparse::kIndices; ++i) {
      add_list_batch(code, sparse.lists[i], std::span(light).subspan(i * kBatch, kBatch),
                     lists);
    }
    EXPECT_EQ(rows, truth);
    EXPECT_EQ(lists, truth);
  }
}

TEST(SparseKernels, AreTheSumToTheStatedBound) {
  const Sparse sparse(4);
  const std::vector<float> light = signed_units(1, Sparse::kIndices);
  std::vector<float> sums(Sparse::kPixels);
  sum_rows(best_kernel_code(), sparse.rows(), light, sums);
  std::vector<double> truth(Sparse::kPixels);
  std::vector<double> absolute(Sparse::kPixels);
  for (std::size_t i = 0; i < Sparse::kIndices; ++i) {
    for (const ListEntry& entry : sparse.lists[i]) {
      truth[entry.pixel] += double{light[i]} * entry.value;
      absolute[entry.pixel] += std::abs(double{light[i]} * entry.value);
    }
  }
  for (std::size_t p = 0; p < sums.size(); ++p) {
    EXPECT_NEAR(double{sums[p]}, truth[p], (Sparse::kIndices + 1) * 0x1p-24 * absolute[p]);
  }
}

}  // namespace
}  // namespace haarlight::relight
