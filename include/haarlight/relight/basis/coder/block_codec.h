// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

/// @file
/// The three kinds of block of a basis file, to bytes and back. Every integer goes through the
/// same steps: zigzag (0, -1, 1, -2 -> 0, 1, 2, 3), split into four byte planes, zstd.
/// Specified in docs/reference/basis-format.md. Pure; safe from any thread.

namespace haarlight::relight {

/// Nonzero coefficients of one group of a tile. Cell = (index of the coefficient in its group)
/// * n_pixels + pixel; strictly increasing.
struct SparseBlock {
  std::vector<std::uint32_t> cell;
  std::vector<std::int32_t> value;
  friend bool operator==(const SparseBlock&, const SparseBlock&) = default;
};

inline constexpr int kMostShift = 63;

/// What a tile stores per pixel besides coefficients.
struct PixelBlock {
  std::vector<std::uint8_t> shift;  ///< (n_pixels): its step is step * 2^-shift
  std::vector<std::int32_t> gain;   ///< (n_pixels): multiples of the clean plate's gain step
  std::vector<float> plate;         ///< (rank, (degree + 1)^2): tile_plate.h; all 0 for no gain
  friend bool operator==(const PixelBlock&, const PixelBlock&) = default;
};

/// What the bytes of a block's numbers are like. It changes how they are packed, not what
/// reads them.
enum class BlockContent {
  repeats,  ///< much of it comes again
  dense,    ///< noise for the most part, with few long repeats: short ones are chance
};

/// Empty bytes for a block without entries.
[[nodiscard]] std::vector<std::byte> encode_sparse(
    const SparseBlock& block, BlockContent content = BlockContent::repeats);
/// @param n_entries  from the index
/// @param n_cells    cells of the group: every cell must be below
/// @param where      named in errors: file, tile and group
/// @throws Error  damaged bytes
[[nodiscard]] SparseBlock decode_sparse(std::span<const std::byte> bytes, std::size_t n_entries,
                                        std::size_t n_cells, const std::string& where);

/// Empty bytes when every number is zero.
[[nodiscard]] std::vector<std::byte> encode_pixels(const PixelBlock& block);
/// @param n_plate  numbers of PixelBlock::plate
[[nodiscard]] PixelBlock decode_pixels(std::span<const std::byte> bytes, std::size_t n_pixels,
                                       std::size_t n_plate, const std::string& where);

/// Floats bit for bit, (n_rows, n_pixels); each row is coded as the difference of its bits to
/// the row before. Empty bytes when every value is +0.
[[nodiscard]] std::vector<std::byte> encode_floats(std::span<const float> values,
                                                   std::size_t n_pixels);
[[nodiscard]] std::vector<float> decode_floats(std::span<const std::byte> bytes,
                                               std::size_t n_rows, std::size_t n_pixels,
                                               const std::string& where);

/// Whole numbers, (n_rows, n_pixels). Pixels of similar size are packed together; each row's
/// low bits that are mere noise are stored raw. Empty bytes when all are zero.
[[nodiscard]] std::vector<std::byte> encode_integers(std::span<const std::int32_t> values,
                                                     std::size_t n_pixels);
/// @throws Error  damaged bytes
[[nodiscard]] std::vector<std::int32_t> decode_integers(std::span<const std::byte> bytes,
                                                        std::size_t n_rows,
                                                        std::size_t n_pixels,
                                                        const std::string& where);

/// XXH3, 64 bits: the checksum of every part of a basis file.
[[nodiscard]] std::uint64_t block_checksum(std::span<const std::byte> bytes) noexcept;

}  // namespace haarlight::relight
