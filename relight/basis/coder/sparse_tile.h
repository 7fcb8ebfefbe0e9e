// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory_resource>
#include <span>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "relight/basis/relight_kernels.h"

/// @file
/// One tile and channel of a quantised basis file, unpacked for repeated relighting: the same
/// coefficients by pixel (rows) and by coefficient (lists), and the clean plate. Numbers as in
/// the file; nothing is rounded.

namespace haarlight::relight {

struct SparseTile {
  std::size_t n_pixels = 0;
  // Rows: pixel-major, see SparseRows. Values beyond 16 bits are split, v = 65536 high + low;
  // the high part has the index of the coefficient + n_lights. Within a row indices ascend.
  std::pmr::vector<std::uint16_t> row_pixels;
  std::pmr::vector<std::uint32_t> row_starts;
  std::pmr::vector<RowBlock> blocks;
  // Lists: coefficient-major, of the indices that have entries, ascending.
  std::pmr::vector<std::uint16_t> list_index;
  std::pmr::vector<std::uint32_t> list_starts;  ///< (lists + 1)
  std::pmr::vector<ListEntry> entries;
  // The plate as in the file; a plate of zeros takes no memory.
  std::pmr::vector<float> plate;        ///< (rank, (degree + 1)^2): tile_plate.h
  std::pmr::vector<std::int32_t> gain;  ///< (n_pixels)
  std::pmr::vector<float>
      scales;                     ///< (n_pixels): the pixel's step / the header's; empty: all 1
  std::uint32_t longest_row = 0;  ///< most entries of any pixel

  SparseTile() = default;
  /// A copy whose rows and plate are allocated from `rows` and whose lists from `lists`: a sum
  /// reads either rows or lists, each from contiguous memory.
  SparseTile(const SparseTile& other, std::pmr::memory_resource* rows,
             std::pmr::memory_resource* lists);
  /// What such a copy takes from each at most.
  [[nodiscard]] std::uint64_t room_of_rows() const noexcept;
  [[nodiscard]] std::uint64_t room_of_lists() const noexcept;

  [[nodiscard]] SparseRows rows() const noexcept { return {row_pixels, row_starts, blocks}; }
  [[nodiscard]] std::span<const ListEntry> list(std::size_t i) const {
    return std::span(entries).subspan(list_starts[i], list_starts[i + 1] - list_starts[i]);
  }
  /// Bytes of the rows, of the lists, and of what both need in addition (plate and steps).
  [[nodiscard]] std::uint64_t row_bytes() const noexcept;
  [[nodiscard]] std::uint64_t list_bytes() const noexcept;
  [[nodiscard]] std::uint64_t pixel_bytes() const noexcept;
};

/// @param basis  quantised, of at most 32 768 lights
/// @throws Error  damaged blocks
[[nodiscard]] SparseTile unpack_tile(const BasisFile& basis, int i_tile, int channel);

}  // namespace haarlight::relight
