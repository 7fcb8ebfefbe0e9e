// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

/// @file
/// The inner loops of repeated relighting, over one tile's values in memory. Sums are float, in
/// an order that is fixed by the data's layout: the same bits for any number of threads, for
/// one environment or a batch, with and without AVX2 (products are rounded before they are
/// added: a fused multiply-add would make results machine-dependent and gain nothing, memory
/// being the limit). The callers bound that rounding error; method and figures:
/// docs/numerics/relight.md, "Kernels". Pure except for `sums`; safe from any thread.

namespace haarlight::relight {

/// How the loops of relight/basis are compiled.
enum class KernelCode {
  portable,       ///< plain C++
  avx2,           ///< x86 with AVX2 and F16C, and nothing wider
  avx2_gather,    ///< the same; factors of sparse rows by the gather instruction, which is the
                  ///< faster way on some processors and the slower on others
  avx512,         ///< as avx2; where it pays with AVX-512 (F, BW, DQ, VL; VNNI where there)
  avx512_gather,  ///< both
};
/// "portable", "avx2", "avx2-gather", "avx512", "avx512-gather"
[[nodiscard]] std::string_view word_of(KernelCode code) noexcept;
[[nodiscard]] constexpr bool has_avx512(KernelCode code) noexcept {
  return code == KernelCode::avx512 || code == KernelCode::avx512_gather;
}
[[nodiscard]] constexpr bool has_gather(KernelCode code) noexcept {
  return code == KernelCode::avx2_gather || code == KernelCode::avx512_gather;
}
/// The fastest on this machine; how rows are added is measured, once, in a tenth of a
/// millisecond. The environment variable HAARLIGHT_KERNELS names another instead.
/// @throws Error  HAARLIGHT_KERNELS is none of the words, or not what this processor has
[[nodiscard]] KernelCode best_kernel_code();

/// Lights of a dense row are padded to this: 4 x 8 running sums.
inline constexpr int kDenseLanes = 32;
/// Environments that share one pass over the data.
inline constexpr int kBatch = 8;

/// Lights [begin, end), multiples of kDenseLanes.
struct LaneRange {
  int begin = 0;
  int end = 0;
};

/// Dense rows of half floats, pixel-major.
struct DenseRows {
  const std::uint16_t* values = nullptr;  ///< (n_pixels, stride)
  std::size_t n_pixels = 0;
  std::size_t stride = 0;  ///< lights, padded with zeros to a multiple of kDenseLanes
};

/// sums[p] = sum over the ranges' lights of w_k T_k. Lights outside the ranges are not read.
/// @param weights  (stride)
/// @param sums     (n_pixels)
void sum_dense(KernelCode code, const DenseRows& rows, std::span<const LaneRange> ranges,
               std::span<const float> weights, std::span<float> sums);
/// The same for kBatch environments at once.
/// @param weights  (stride / 8, kBatch, 8): eight lights of each environment in turn
/// @param sums     (n_pixels, kBatch)
void sum_dense_batch(KernelCode code, const DenseRows& rows, std::span<const LaneRange> ranges,
                     std::span<const float> weights, std::span<float> sums);

/// The i-th coefficient of eight pixels.
struct RowBlock {
  std::array<std::uint16_t, 8> index{};
  std::array<std::int16_t, 8> value{};
};

/// Sparse rows, eight pixels side by side: slot s holds pixels[8 s ...] in the blocks
/// [starts[s], starts[s + 1]); shorter rows are padded with zeros, which are few, since pixels
/// are ordered by the length of their rows. Pixels without coefficients are in no slot.
struct SparseRows {
  std::span<const std::uint16_t> pixels;
  std::span<const std::uint32_t> starts;  ///< (slots + 1)
  std::span<const RowBlock> blocks;
};

/// sums[p] = sum of value * light[index] for the pixels that have a row; the others are
/// unchanged.
/// @param light  a factor for every index
/// @param sums   (n_pixels)
void sum_rows(KernelCode code, const SparseRows& rows, std::span<const float> light,
              std::span<float> sums);
/// @param light  (indices, kBatch)
/// @param sums   (n_pixels, kBatch)
void sum_rows_batch(KernelCode code, const SparseRows& rows, std::span<const float> light,
                    std::span<float> sums);

/// One pixel's value of a coefficient.
struct ListEntry {
  std::uint16_t pixel = 0;
  std::int16_t value = 0;
};

/// sums[pixel] += value * factor over one coefficient's list. Adding lists in ascending order
/// of their coefficients is bit-identical to sum_rows(), whose rows have the same order.
void add_list(std::span<const ListEntry> list, float factor, std::span<float> sums);
/// @param factors  (kBatch)
/// @param sums     (n_pixels, kBatch)
void add_list_batch(KernelCode code, std::span<const ListEntry> list,
                    std::span<const float> factors, std::span<float> sums);

}  // namespace haarlight::relight
