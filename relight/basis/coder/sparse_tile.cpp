// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/sparse_tile.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/count.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kLanes = 8;
constexpr int kHighUnit = 1 << 16;

/// A part of a coefficient that fits 16 bits.
struct Part {
  std::uint16_t index = 0;
  std::uint16_t pixel = 0;
  std::int16_t value = 0;
};

/// v = 65536 high + low with low in [-32768, 32767]: exact for every value of a file.
void add_parts(int index, std::size_t pixel, std::int32_t value, int n_lights,
               std::vector<Part>& parts) {
  const auto low = static_cast<std::int16_t>(value);
  const int high = static_cast<int>((std::int64_t{value} - low) / kHighUnit);
  const auto p = static_cast<std::uint16_t>(pixel);
  if (low != 0) {
    parts.push_back({static_cast<std::uint16_t>(index), p, low});
  }
  if (high != 0) {
    parts.push_back(
        {static_cast<std::uint16_t>(index + n_lights), p, static_cast<std::int16_t>(high)});
  }
}

void fill_rows(const std::vector<Part>& parts, SparseTile& tile) {
  std::vector<std::uint32_t> length(tile.n_pixels);
  for (const Part& part : parts) {
    ++length[part.pixel];
  }
  for (std::size_t p = 0; p < tile.n_pixels; ++p) {
    if (length[p] > 0) {
      tile.row_pixels.push_back(static_cast<std::uint16_t>(p));
    }
  }
  std::stable_sort(
      tile.row_pixels.begin(), tile.row_pixels.end(),
      [&length](std::uint16_t a, std::uint16_t b) { return length[a] > length[b]; });
  tile.longest_row = tile.row_pixels.empty() ? 0 : length[tile.row_pixels.front()];
  std::vector<std::uint32_t> next(tile.n_pixels);  // block of the pixel's next entry
  std::vector<std::uint8_t> lane(tile.n_pixels);
  tile.row_starts.push_back(0);
  for (std::size_t i = 0; i < tile.row_pixels.size(); ++i) {
    const std::size_t p = tile.row_pixels[i];
    if (i % kLanes == 0) {
      tile.row_starts.push_back(tile.row_starts.back() + length[p]);
    }
    next[p] = tile.row_starts[i / kLanes];
    lane[p] = static_cast<std::uint8_t>(i % kLanes);
  }
  tile.blocks.resize(tile.row_starts.back());
  for (const Part& part : parts) {
    RowBlock& block = tile.blocks[next[part.pixel]++];
    block.index[lane[part.pixel]] = part.index;
    block.value[lane[part.pixel]] = part.value;
  }
}

void fill_lists(const std::vector<Part>& parts, SparseTile& tile) {
  tile.entries.reserve(parts.size());
  for (const Part& part : parts) {
    if (tile.list_index.empty() || tile.list_index.back() != part.index) {
      tile.list_index.push_back(part.index);
      tile.list_starts.push_back(static_cast<std::uint32_t>(tile.entries.size()));
    }
    tile.entries.push_back({part.pixel, part.value});
  }
  tile.list_starts.push_back(static_cast<std::uint32_t>(tile.entries.size()));
}

template <class T>
std::uint64_t bytes_of(const std::pmr::vector<T>& values) noexcept {
  return values.size() * sizeof(T);
}

}  // namespace

SparseTile::SparseTile(const SparseTile& other, std::pmr::memory_resource* rows,
                       std::pmr::memory_resource* lists)
    : n_pixels(other.n_pixels),
      row_pixels(other.row_pixels, rows),
      row_starts(other.row_starts, rows),
      blocks(other.blocks, rows),
      list_index(other.list_index, lists),
      list_starts(other.list_starts, lists),
      entries(other.entries, lists),
      plate(other.plate, rows),
      gain(other.gain, rows),
      scales(other.scales, rows),
      longest_row(other.longest_row) {}

std::uint64_t SparseTile::room_of_rows() const noexcept {
  return row_bytes() + pixel_bytes() + 6 * alignof(std::max_align_t);
}

std::uint64_t SparseTile::room_of_lists() const noexcept {
  return list_bytes() + 3 * alignof(std::max_align_t);
}

std::uint64_t SparseTile::row_bytes() const noexcept {
  return bytes_of(row_pixels) + bytes_of(row_starts) + bytes_of(blocks);
}

std::uint64_t SparseTile::list_bytes() const noexcept {
  return bytes_of(list_index) + bytes_of(list_starts) + bytes_of(entries);
}

std::uint64_t SparseTile::pixel_bytes() const noexcept {
  return bytes_of(plate) + bytes_of(gain) + bytes_of(scales);
}

SparseTile unpack_tile(const BasisFile& basis, int i_tile, int channel) {
  const BasisHeader& header = basis.header();
  SparseTile tile;
  tile.n_pixels = count(basis.tile_rect(i_tile).n_pixels());
  const PixelBlock pixels = basis.pixels(i_tile, channel);
  std::vector<Part> parts;
  for (int g = 0; g < basis.n_groups(); ++g) {
    if (basis.is_group_empty(i_tile, channel, g)) {
      continue;
    }
    const SparseBlock block = basis.sparse(i_tile, channel, g);
    for (std::size_t e = 0; e < block.cell.size(); ++e) {
      const std::size_t position = count(basis.group_begin(g)) + block.cell[e] / tile.n_pixels;
      add_parts(basis.order()[position], block.cell[e] % tile.n_pixels, block.value[e],
                header.dims.n_lights, parts);
    }
  }
  // By index; the pixels of one index stay in order.
  std::stable_sort(parts.begin(), parts.end(),
                   [](const Part& a, const Part& b) { return a.index < b.index; });
  fill_rows(parts, tile);
  fill_lists(parts, tile);
  if (std::any_of(pixels.gain.begin(), pixels.gain.end(),
                  [](std::int32_t g) { return g != 0; })) {
    tile.plate.assign(pixels.plate.begin(), pixels.plate.end());
    tile.gain.assign(pixels.gain.begin(), pixels.gain.end());
  }
  if (std::all_of(pixels.shift.begin(), pixels.shift.end(),
                  [](std::uint8_t shift) { return shift == 0; })) {
    return tile;
  }
  tile.scales.resize(tile.n_pixels);
  std::transform(pixels.shift.begin(), pixels.shift.end(), tile.scales.begin(),
                 [](std::uint8_t shift) { return std::ldexp(1.0F, -int{shift}); });
  return tile;
}

}  // namespace haarlight::relight
