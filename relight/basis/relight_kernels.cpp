// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/relight_kernels.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdlib>
#include <memory>
#include <numeric>
#include <vector>

#include <fmt/format.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/basis/half_float.h"
#include "relight/basis/prefetch.h"

#if defined(__x86_64__)
#include <cpuid.h>
#include <immintrin.h>
#endif

namespace haarlight::relight {

namespace {

constexpr std::size_t kLanes = 8;

/// Eight running sums to one, in the order in which a vector register is folded.
float fold(const float* a) {
  return ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]));
}

std::span<const std::uint16_t> slot_pixels(const SparseRows& rows, std::size_t slot) {
  const std::size_t begin = slot * kLanes;
  return rows.pixels.subspan(begin, std::min(kLanes, rows.pixels.size() - begin));
}

bool has_slots(const SparseRows& rows) {
  return rows.starts.size() == (rows.pixels.size() + kLanes - 1) / kLanes + 1;
}

void sum_dense_portable(const DenseRows& rows, std::span<const LaneRange> ranges,
                        const float* weights, float* sums) {
  for (std::size_t p = 0; p < rows.n_pixels; ++p) {
    const std::uint16_t* row = rows.values + p * rows.stride;
    std::array<float, kDenseLanes> a{};
    for (const LaneRange& range : ranges) {
      for (int k = range.begin; k < range.end; k += kDenseLanes) {
        for (int i = 0; i < kDenseLanes; ++i) {
          a[static_cast<std::size_t>(i)] += weights[k + i] * half_to_float(row[k + i]);
        }
      }
    }
    std::array<float, kLanes> b{};
    for (std::size_t i = 0; i < kLanes; ++i) {
      b[i] = (a[i] + a[i + kLanes]) + (a[i + 2 * kLanes] + a[i + 3 * kLanes]);
    }
    sums[p] = fold(b.data());
  }
}

void sum_dense_batch_portable(const DenseRows& rows, std::span<const LaneRange> ranges,
                              const float* weights, float* sums) {
  for (std::size_t p = 0; p < rows.n_pixels; ++p) {
    const std::uint16_t* row = rows.values + p * rows.stride;
    std::array<std::array<float, kDenseLanes>, kBatch> a{};
    for (const LaneRange& range : ranges) {
      for (int k = range.begin; k < range.end; k += kDenseLanes) {
        for (std::size_t i = 0; i < kDenseLanes; ++i) {
          const float t = half_to_float(row[static_cast<std::size_t>(k) + i]);
          const float* w =
              weights + (static_cast<std::size_t>(k) + i) / kLanes * kBatch * kLanes;
          for (std::size_t e = 0; e < kBatch; ++e) {
            a[e][i] += w[e * kLanes + i % kLanes] * t;
          }
        }
      }
    }
    for (std::size_t e = 0; e < kBatch; ++e) {
      std::array<float, kLanes> b{};
      for (std::size_t i = 0; i < kLanes; ++i) {
        b[i] = (a[e][i] + a[e][i + kLanes]) + (a[e][i + 2 * kLanes] + a[e][i + 3 * kLanes]);
      }
      sums[p * kBatch + e] = fold(b.data());
    }
  }
}

/// Slots' sums to their pixels, only at the end: scattered stores slow the reads between them.
void put_slots(const SparseRows& rows, const float* in_slots, float* sums) {
  for (std::size_t i = 0; i < rows.pixels.size(); ++i) {
    sums[rows.pixels[i]] = in_slots[i];
  }
}

void sum_rows_portable(const SparseRows& rows, const float* light, float* sums) {
  const std::size_t n_slots = rows.starts.size() - 1;
  const auto in_slots = std::make_unique_for_overwrite<float[]>(n_slots * kLanes);
  for (std::size_t s = 0; s < n_slots; ++s) {
    std::array<float, kLanes> a{};
    for (std::size_t b = rows.starts[s]; b < rows.starts[s + 1]; ++b) {
      const RowBlock& block = rows.blocks[b];
      prefetch_ahead(block.index.data());
      for (std::size_t i = 0; i < kLanes; ++i) {
        a[i] += static_cast<float>(block.value[i]) * light[block.index[i]];
      }
    }
    std::copy_n(a.data(), kLanes, in_slots.get() + s * kLanes);
  }
  put_slots(rows, in_slots.get(), sums);
}

void sum_rows_batch_portable(const SparseRows& rows, const float* light, float* sums) {
  for (std::size_t s = 0; s + 1 < rows.starts.size(); ++s) {
    std::array<std::array<float, kBatch>, kLanes> a{};
    for (std::size_t b = rows.starts[s]; b < rows.starts[s + 1]; ++b) {
      const RowBlock& block = rows.blocks[b];
      for (std::size_t i = 0; i < kLanes; ++i) {
        const auto value = static_cast<float>(block.value[i]);
        const float* l = light + std::size_t{block.index[i]} * kBatch;
        for (std::size_t e = 0; e < kBatch; ++e) {
          a[i][e] += value * l[e];
        }
      }
    }
    const auto pixels = slot_pixels(rows, s);
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      std::copy_n(a[i].data(), kBatch, sums + std::size_t{pixels[i]} * kBatch);
    }
  }
}

/// Plain loops that the compiler vectorises for whichever target the caller allows.
[[gnu::always_inline]] inline void add_list_batch_body(std::span<const ListEntry> list,
                                                       const float* factors, float* sums) {
  for (const ListEntry& entry : list) {
    const auto value = static_cast<float>(entry.value);
    float* to = sums + std::size_t{entry.pixel} * kBatch;
    for (std::size_t e = 0; e < kBatch; ++e) {
      to[e] += value * factors[e];
    }
  }
}

#if defined(__x86_64__)

[[gnu::target("avx2,f16c")]] float fold_avx2(__m256 a) {
  const __m128 four = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
  const __m128 two = _mm_add_ps(four, _mm_movehl_ps(four, four));
  return _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps(two, two, 1)));
}

[[gnu::target("avx2,f16c")]] __m256 load_half(const std::uint16_t* from) {
  return _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from)));
}

[[gnu::target("avx2,f16c")]] __m256 add_product(__m256 sum, __m256 a, __m256 b) {
  return _mm256_add_ps(sum, _mm256_mul_ps(a, b));
}

[[gnu::target("avx2,f16c")]] void sum_dense_avx2(const DenseRows& rows,
                                                 std::span<const LaneRange> ranges,
                                                 const float* weights, float* sums) {
  for (std::size_t p = 0; p < rows.n_pixels; ++p) {
    const std::uint16_t* row = rows.values + p * rows.stride;
    __m256 a0 = _mm256_setzero_ps();
    __m256 a1 = a0;
    __m256 a2 = a0;
    __m256 a3 = a0;
    for (const LaneRange& range : ranges) {
      for (int k = range.begin; k < range.end; k += kDenseLanes) {
        const std::uint16_t* t = row + k;
        const float* w = weights + k;
        prefetch_ahead(t);
        a0 = add_product(a0, _mm256_loadu_ps(w), load_half(t));
        a1 = add_product(a1, _mm256_loadu_ps(w + 8), load_half(t + 8));
        a2 = add_product(a2, _mm256_loadu_ps(w + 16), load_half(t + 16));
        a3 = add_product(a3, _mm256_loadu_ps(w + 24), load_half(t + 24));
      }
    }
    sums[p] = fold_avx2(_mm256_add_ps(_mm256_add_ps(a0, a1), _mm256_add_ps(a2, a3)));
  }
}

/// One of the four octets of every 32 lights, so that eight environments' sums stay in
/// registers; a row is in the L1 cache from its first octet on.
[[gnu::target("avx2,f16c")]] void sum_octets(const std::uint16_t* row,
                                             std::span<const LaneRange> ranges,
                                             const float* weights, int octet, __m256* out) {
  constexpr std::ptrdiff_t kEight = kLanes;
  __m256 a[kBatch];
  for (__m256& sum : a) {
    sum = _mm256_setzero_ps();
  }
  for (const LaneRange& range : ranges) {
    for (std::ptrdiff_t k = range.begin + kEight * octet; k < range.end; k += kDenseLanes) {
      const __m256 t = load_half(row + k);
      const float* w = weights + k * kBatch;
      if (octet == 0) {
        prefetch_ahead(row + k);
      }
#pragma GCC unroll 8
      for (std::ptrdiff_t e = 0; e < kBatch; ++e) {
        a[e] = add_product(a[e], _mm256_loadu_ps(w + kEight * e), t);
      }
    }
  }
  for (std::ptrdiff_t e = 0; e < kBatch; ++e) {
    out[e] = a[e];
  }
}

[[gnu::target("avx2,f16c")]] void sum_dense_batch_avx2(const DenseRows& rows,
                                                       std::span<const LaneRange> ranges,
                                                       const float* weights, float* sums) {
  __m256 a[4][kBatch];
  for (std::size_t p = 0; p < rows.n_pixels; ++p) {
    const std::uint16_t* row = rows.values + p * rows.stride;
    for (int octet = 0; octet < 4; ++octet) {
      sum_octets(row, ranges, weights, octet, a[octet]);
    }
    for (std::size_t e = 0; e < kBatch; ++e) {
      sums[p * kBatch + e] = fold_avx2(
          _mm256_add_ps(_mm256_add_ps(a[0][e], a[1][e]), _mm256_add_ps(a[2][e], a[3][e])));
    }
  }
}

[[gnu::target("avx2,f16c")]] __m256 row_products(const RowBlock& block, const float* light) {
  const __m256i index = _mm256_cvtepu16_epi32(
      _mm_loadu_si128(reinterpret_cast<const __m128i*>(block.index.data())));
  const __m256i value = _mm256_cvtepi16_epi32(
      _mm_loadu_si128(reinterpret_cast<const __m128i*>(block.value.data())));
  return _mm256_mul_ps(_mm256_cvtepi32_ps(value), _mm256_i32gather_ps(light, index, 4));
}

[[gnu::target("avx2,f16c")]] void sum_rows_gather(const SparseRows& rows, const float* light,
                                                  float* sums) {
  const std::size_t n_slots = rows.starts.size() - 1;
  const auto in_slots = std::make_unique_for_overwrite<float[]>(n_slots * kLanes);
  for (std::size_t s = 0; s < n_slots; ++s) {
    const RowBlock* block = rows.blocks.data() + rows.starts[s];
    const RowBlock* end = rows.blocks.data() + rows.starts[s + 1];
    __m256 a = _mm256_setzero_ps();
    for (; end - block >= 2; block += 2) {  // one cache line
      prefetch_ahead(block->index.data());
      a = _mm256_add_ps(a, row_products(block[0], light));
      a = _mm256_add_ps(a, row_products(block[1], light));
    }
    if (block != end) {
      prefetch_ahead(block->index.data());
      a = _mm256_add_ps(a, row_products(*block, light));
    }
    _mm256_storeu_ps(in_slots.get() + s * kLanes, a);
  }
  put_slots(rows, in_slots.get(), sums);
}

[[gnu::target("avx2,f16c")]] void sum_rows_batch_avx2(const SparseRows& rows,
                                                      const float* light, float* sums) {
  alignas(32) std::array<float, kLanes> values;
  for (std::size_t s = 0; s + 1 < rows.starts.size(); ++s) {
    __m256 a[kLanes];
    for (__m256& sum : a) {
      sum = _mm256_setzero_ps();
    }
    for (std::size_t b = rows.starts[s]; b < rows.starts[s + 1]; ++b) {
      const RowBlock& block = rows.blocks[b];
      prefetch_ahead(block.index.data());
      _mm256_store_ps(values.data(),
                      _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(_mm_loadu_si128(
                          reinterpret_cast<const __m128i*>(block.value.data())))));
#pragma GCC unroll 8
      for (std::size_t i = 0; i < kLanes; ++i) {
        a[i] = add_product(a[i], _mm256_broadcast_ss(&values[i]),
                           _mm256_loadu_ps(light + std::size_t{block.index[i]} * kBatch));
      }
    }
    const auto pixels = slot_pixels(rows, s);
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      _mm256_storeu_ps(sums + std::size_t{pixels[i]} * kBatch, a[i]);
    }
  }
}

[[gnu::target("avx2,f16c")]] void add_list_batch_avx2(std::span<const ListEntry> list,
                                                      const float* factors, float* sums) {
  add_list_batch_body(list, factors, sums);
}

#endif

bool machine_has_avx2() {
#if defined(__x86_64__)
  unsigned a = 0;
  unsigned b = 0;
  unsigned c = 0;
  unsigned d = 0;
  return __builtin_cpu_supports("avx2") != 0 && __get_cpuid(1, &a, &b, &c, &d) != 0 &&
         (c & bit_F16C) != 0;
#else
  return false;
#endif
}

bool machine_has_avx512() {
#if defined(__x86_64__)
  return machine_has_avx2() && __builtin_cpu_supports("avx512f") != 0 &&
         __builtin_cpu_supports("avx512bw") != 0 && __builtin_cpu_supports("avx512dq") != 0 &&
         __builtin_cpu_supports("avx512vl") != 0;
#else
  return false;
#endif
}

/// Which of the two ways to add sparse rows is the faster, over 45 kB of them: the cores' own
/// speed.
bool gathers_faster() {
  constexpr std::size_t kSlots = 64;
  constexpr std::size_t kBlocks = 22;
  constexpr std::size_t kLights = 1024;
  constexpr int kTurns = 5;
  std::vector<std::uint16_t> pixels(kSlots * kLanes);
  std::iota(pixels.begin(), pixels.end(), std::uint16_t{0});
  std::vector<std::uint32_t> starts(kSlots + 1);
  std::vector<RowBlock> blocks(kSlots * kBlocks);
  for (std::size_t i = 0; i < starts.size(); ++i) {
    starts[i] = static_cast<std::uint32_t>(kBlocks * i);
  }
  for (std::size_t i = 0; i < blocks.size() * kLanes; ++i) {
    blocks[i / kLanes].index[i % kLanes] = static_cast<std::uint16_t>(hash_key(1, i) % kLights);
    blocks[i / kLanes].value[i % kLanes] = 1;
  }
  const std::vector<float> light(kLights, 1.0F);
  std::vector<float> sums(pixels.size());
  constexpr std::array kWays{KernelCode::avx2, KernelCode::avx2_gather};
  std::array<std::chrono::steady_clock::duration, kWays.size()> least;
  least.fill(std::chrono::steady_clock::duration::max());
  for (int turn = 0; turn < kTurns; ++turn) {
    for (std::size_t way = 0; way < kWays.size(); ++way) {
      const auto start = std::chrono::steady_clock::now();
      sum_rows(kWays[way], {pixels, starts, blocks}, light, sums);
      least[way] = std::min(least[way], std::chrono::steady_clock::now() - start);
    }
  }
  return least[1] < least[0];
}

constexpr std::array kAllCodes{KernelCode::portable, KernelCode::avx2, KernelCode::avx2_gather,
                               KernelCode::avx512, KernelCode::avx512_gather};

KernelCode fastest_code() {
  if (!machine_has_avx2()) {
    return KernelCode::portable;
  }
  if (machine_has_avx512()) {
    return gathers_faster() ? KernelCode::avx512_gather : KernelCode::avx512;
  }
  return gathers_faster() ? KernelCode::avx2_gather : KernelCode::avx2;
}

KernelCode find_best_code() {
  const char* const word = std::getenv("HAARLIGHT_KERNELS");  // NOLINT(concurrency-mt-unsafe)
  if (word == nullptr) {
    return fastest_code();
  }
  const auto* const found = std::ranges::find_if(
      kAllCodes, [word](KernelCode code) { return word_of(code) == word; });
  if (found == kAllCodes.end()) {
    throw Error(
        fmt::format("\"{}\" is no way to sum lights", word), "HAARLIGHT_KERNELS",
        "portable, avx2, avx2-gather, avx512 or avx512-gather; or leave the variable out",
        ExitCode::usage);
  }
  if (has_avx512(*found) && !machine_has_avx512()) {
    throw Error("this processor has no AVX-512 (F, BW, DQ and VL)", "HAARLIGHT_KERNELS",
                "portable, avx2 or avx2-gather; or leave the variable out", ExitCode::usage);
  }
  if (*found != KernelCode::portable && !machine_has_avx2()) {
    throw Error("this processor has no AVX2 with F16C", "HAARLIGHT_KERNELS",
                "portable; or leave the variable out", ExitCode::usage);
  }
  return *found;
}

}  // namespace

std::string_view word_of(KernelCode code) noexcept {
  switch (code) {
    case KernelCode::portable:
      return "portable";
    case KernelCode::avx2:
      return "avx2";
    case KernelCode::avx2_gather:
      return "avx2-gather";
    case KernelCode::avx512:
      return "avx512";
    case KernelCode::avx512_gather:
      break;
  }
  return "avx512-gather";
}

KernelCode best_kernel_code() {
  // Found once: a virtual machine takes about 20 microseconds to answer CPUID.
  static const KernelCode kBest = find_best_code();
  return kBest;
}

void sum_dense(KernelCode code, const DenseRows& rows, std::span<const LaneRange> ranges,
               std::span<const float> weights, std::span<float> sums) {
  HAARLIGHT_EXPECTS(rows.stride % kDenseLanes == 0 && weights.size() == rows.stride &&
                        sums.size() == rows.n_pixels,
                    "one weight per light, one sum per pixel");
#if defined(__x86_64__)
  if (code != KernelCode::portable) {
    sum_dense_avx2(rows, ranges, weights.data(), sums.data());
    return;
  }
#endif
  (void)code;
  sum_dense_portable(rows, ranges, weights.data(), sums.data());
}

void sum_dense_batch(KernelCode code, const DenseRows& rows, std::span<const LaneRange> ranges,
                     std::span<const float> weights, std::span<float> sums) {
  HAARLIGHT_EXPECTS(rows.stride % kDenseLanes == 0 && weights.size() == rows.stride * kBatch &&
                        sums.size() == rows.n_pixels * kBatch,
                    "one weight per light, one sum per pixel, for each environment");
#if defined(__x86_64__)
  if (code != KernelCode::portable) {
    sum_dense_batch_avx2(rows, ranges, weights.data(), sums.data());
    return;
  }
#endif
  (void)code;
  sum_dense_batch_portable(rows, ranges, weights.data(), sums.data());
}

void sum_rows(KernelCode code, const SparseRows& rows, std::span<const float> light,
              std::span<float> sums) {
  HAARLIGHT_EXPECTS(has_slots(rows), "eight pixels a slot");
#if defined(__x86_64__)
  if (has_gather(code)) {
    sum_rows_gather(rows, light.data(), sums.data());
    return;
  }
#endif
  (void)code;
  sum_rows_portable(rows, light.data(), sums.data());
}

void sum_rows_batch(KernelCode code, const SparseRows& rows, std::span<const float> light,
                    std::span<float> sums) {
  HAARLIGHT_EXPECTS(has_slots(rows), "eight pixels a slot");
#if defined(__x86_64__)
  if (code != KernelCode::portable) {
    sum_rows_batch_avx2(rows, light.data(), sums.data());
    return;
  }
#endif
  (void)code;
  sum_rows_batch_portable(rows, light.data(), sums.data());
}

void add_list(std::span<const ListEntry> list, float factor, std::span<float> sums) {
  for (const ListEntry& entry : list) {
    sums[entry.pixel] += static_cast<float>(entry.value) * factor;
  }
}

void add_list_batch(KernelCode code, std::span<const ListEntry> list,
                    std::span<const float> factors, std::span<float> sums) {
  HAARLIGHT_EXPECTS(factors.size() == kBatch, "one factor per environment");
#if defined(__x86_64__)
  if (code != KernelCode::portable) {
    add_list_batch_avx2(list, factors.data(), sums.data());
    return;
  }
#endif
  (void)code;
  add_list_batch_body(list, factors.data(), sums.data());
}

}  // namespace haarlight::relight
