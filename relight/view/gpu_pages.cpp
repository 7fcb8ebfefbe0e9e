// SPDX-License-Identifier: Apache-2.0
#include "relight/view/gpu_pages.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

#include <Eigen/Core>
#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kHeaderBytes = 16;
constexpr std::size_t kRecordBytes = 8;

/// The positions of one tile's pixels in its pages.
struct PageOffsets {
  TileRect rect;
  int side = 0;
  [[nodiscard]] std::size_t operator()(std::size_t pixel) const {
    return pixel / count(rect.width) * count(side) + pixel % count(rect.width);
  }
  [[nodiscard]] std::size_t n_values() const { return count(side) * count(side); }
};

void append_u32(std::string& to, std::uint32_t value) {
  for (unsigned i = 0; i < 4; ++i) {
    to += static_cast<char>((value >> (8 * i)) & 0xffU);
  }
}

/// Pages of one tile, in the order they are added.
class PageList {
 public:
  PageList(int tile, std::size_t page_bytes) : tile_(tile), page_bytes_(page_bytes) {}

  /// A new page of zeros. The pointer holds until the next call.
  char* add(int picture, unsigned digit) {
    append_u32(records_, static_cast<std::uint32_t>(picture));
    append_u32(records_, (static_cast<std::uint32_t>(tile_) << 8U) | digit);
    pages_.resize(pages_.size() + page_bytes_);
    return pages_.data() + pages_.size() - page_bytes_;
  }

  [[nodiscard]] const std::string& records() const { return records_; }
  [[nodiscard]] const std::string& pages() const { return pages_; }

 private:
  int tile_;
  std::size_t page_bytes_;
  std::string records_;
  std::string pages_;
};

template <class T>
void put(char* page, std::size_t offset, T value) {
  static_assert(sizeof(T) <= 2);
  const auto bits = static_cast<std::uint16_t>(static_cast<std::make_unsigned_t<T>>(value));
  page[offset * sizeof(T)] = static_cast<char>(bits & 0xffU);
  if constexpr (sizeof(T) == 2) {
    page[offset * 2 + 1] = static_cast<char>(bits >> 8U);
  }
}

/// Adds a picture of integers as pages of the digits T. Values are consumed.
/// @param offsets  of each value in the page
template <class T>
void add_integers(PageList& list, int picture, std::span<const std::size_t> offsets,
                  std::span<std::int64_t> values) {
  constexpr std::int64_t kBase = std::int64_t{1} << (8 * sizeof(T));
  for (unsigned digit = 0;
       std::any_of(values.begin(), values.end(), [](std::int64_t v) { return v != 0; });
       ++digit) {
    char* page = list.add(picture, digit);
    for (std::size_t i = 0; i < values.size(); ++i) {
      const auto part = static_cast<T>(values[i] & (kBase - 1));  // two's complement: balanced
      put<T>(page, offsets[i], part);
      values[i] = (values[i] - part) / kBase;
    }
  }
}

void require_tiles(const BasisFile& basis, TileRun tiles, std::size_t bytes,
                   std::size_t n_pictures) {
  if (tiles.first < 0 || tiles.last < tiles.first || tiles.last >= basis.n_tiles()) {
    throw Error(fmt::format("no tiles {} to {}", tiles.first, tiles.last), basis.name(),
                fmt::format("tiles are numbered from 0 to {}", basis.n_tiles() - 1));
  }
  const std::size_t n_tiles = count(tiles.last - tiles.first + 1);
  if (n_tiles > 1 && n_tiles * n_pictures * bytes > kMostPageBytes) {
    throw Error(
        fmt::format("{} tiles of {} pictures are too much for one answer", n_tiles, n_pictures),
        basis.name(), "ask for fewer tiles at a time");
  }
}

/// Runs `fill` for every tile in parallel, and packs the results in tile order.
template <class Fill>
std::string pack(const BasisFile& basis, TileRun tiles, std::size_t bytes_per_value,
                 std::size_t n_pictures, const Fill& fill) {
  const int side = page_side(basis.header());
  const std::size_t page_bytes = count(side) * count(side) * bytes_per_value;
  require_tiles(basis, tiles, page_bytes, n_pictures);
  const std::size_t n_tiles = count(tiles.last - tiles.first + 1);
  std::vector<PageList> lists;
  lists.reserve(n_tiles);
  for (int t = tiles.first; t <= tiles.last; ++t) {
    lists.emplace_back(t, page_bytes);
  }
  parallel_for(n_tiles, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const int tile = tiles.first + static_cast<int>(t);
      fill(tile, PageOffsets{basis.tile_rect(tile), side}, lists[t]);
    }
  });
  std::size_t n_pages = 0;
  for (const PageList& list : lists) {
    n_pages += list.records().size() / kRecordBytes;
  }
  std::string out = "HLVP";
  out.reserve(kHeaderBytes + n_pages * (kRecordBytes + page_bytes));
  append_u32(out, static_cast<std::uint32_t>(n_pages));
  append_u32(out, static_cast<std::uint32_t>(page_bytes));
  append_u32(out, 0);
  for (const PageList& list : lists) {
    out += list.records();
  }
  for (const PageList& list : lists) {
    out += list.pages();
  }
  return out;
}

void require_channel(const BasisFile& basis, int channel) {
  if (channel < 0 || channel >= basis.header().dims.channels) {
    throw Error(
        fmt::format("no channel {}", channel), basis.name(),
        fmt::format("channels are numbered from 0 to {}", basis.header().dims.channels - 1));
  }
}

/// Entries of one coefficient are neighbours in a block.
void add_sparse(const BasisFile& basis, const SparseBlock& block, int group,
                const PageOffsets& offsets, PageList& list) {
  const std::size_t n_pixels = count(offsets.rect.n_pixels());
  std::vector<std::size_t> where;
  std::vector<std::int64_t> values;
  for (std::size_t e = 0; e < block.cell.size();) {
    const std::size_t offset = block.cell[e] / n_pixels;
    where.clear();
    values.clear();
    for (; e < block.cell.size() && block.cell[e] / n_pixels == offset; ++e) {
      where.push_back(offsets(block.cell[e] - offset * n_pixels));
      values.push_back(block.value[e]);
    }
    const int picture = basis.order()[count(basis.group_begin(group)) + offset];
    add_integers<std::int8_t>(list, picture, where, values);
  }
}

void add_floats(const BasisFile& basis, const std::vector<float>& rows, int group,
                const PageOffsets& offsets, PageList& list) {
  const std::size_t n_pixels = count(offsets.rect.n_pixels());
  const auto factor = static_cast<float>(1.0 / half_scale(basis.header()));
  for (int k = basis.group_begin(group); k < basis.group_end(group); ++k) {
    const std::span row =
        std::span(rows).subspan(count(k - basis.group_begin(group)) * n_pixels, n_pixels);
    if (std::all_of(row.begin(), row.end(), [](float v) { return v == 0.0F; })) {
      continue;
    }
    char* page = list.add(basis.order()[count(k)], 0);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      const Eigen::half value(row[p] * factor);
      put(page, offsets(p), Eigen::numext::bit_cast<std::uint16_t>(value));
    }
  }
}

}  // namespace

int page_side(const BasisHeader& header) { return (header.tile + 3) / 4 * 4; }

double half_scale(const BasisHeader& header) {
  if (header.coding == BasisCoding::quantised || !(header.peak > 0.0)) {
    return 1.0;
  }
  int exponent = 0;
  (void)std::frexp(header.peak, &exponent);
  return std::ldexp(1.0, exponent);
}

std::string coefficient_pages(const BasisFile& basis, int channel, int group, TileRun tiles) {
  require_channel(basis, channel);
  if (group < 0 || group >= basis.n_groups()) {
    throw Error(fmt::format("no group {}", group), basis.name(),
                fmt::format("groups are numbered from 0 to {}", basis.n_groups() - 1));
  }
  const bool is_lossless = basis.header().coding != BasisCoding::quantised;
  return pack(basis, tiles, is_lossless ? 2 : 1,
              count(basis.group_end(group) - basis.group_begin(group)),
              [&](int tile, const PageOffsets& offsets, PageList& list) {
                if (basis.is_group_empty(tile, channel, group)) {
                  return;
                }
                if (is_lossless) {
                  add_floats(basis, basis.floats(tile, channel, group), group, offsets, list);
                } else {
                  add_sparse(basis, basis.sparse(tile, channel, group), group, offsets, list);
                }
              });
}

std::string gain_pages(const BasisFile& basis, int channel, TileRun tiles) {
  require_channel(basis, channel);
  const bool has_plate = basis.header().plate_rank > 0;
  return pack(basis, tiles, 2, 1, [&](int tile, const PageOffsets& offsets, PageList& list) {
    if (!has_plate) {
      return;
    }
    const PixelBlock pixels = basis.pixels(tile, channel);
    std::vector<std::size_t> where(pixels.gain.size());
    std::vector<std::int64_t> values(pixels.gain.begin(), pixels.gain.end());
    for (std::size_t p = 0; p < where.size(); ++p) {
      where[p] = offsets(p);
    }
    add_integers<std::int16_t>(list, 0, where, values);
  });
}

std::string plate_polynomials(const BasisFile& basis, int channel, TileRun tiles) {
  require_channel(basis, channel);
  const std::size_t n = count(basis.header().n_plate());
  require_tiles(basis, tiles, n * sizeof(float), 1);
  std::vector<float> numbers(count(tiles.last - tiles.first + 1) * n);
  if (n > 0) {
    parallel_for(numbers.size() / n, 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t t = begin; t < end; ++t) {
        const PixelBlock pixels = basis.pixels(tiles.first + static_cast<int>(t), channel);
        std::copy(pixels.plate.begin(), pixels.plate.end(),
                  numbers.begin() + static_cast<std::ptrdiff_t>(t * n));
      }
    });
  }
  static_assert(std::endian::native == std::endian::little);
  return {reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(float)};
}

std::string shift_pages(const BasisFile& basis, int channel, TileRun tiles) {
  require_channel(basis, channel);
  const bool is_quantised = basis.header().coding == BasisCoding::quantised;
  return pack(basis, tiles, 1, 1, [&](int tile, const PageOffsets& offsets, PageList& list) {
    if (!is_quantised) {
      return;
    }
    const PixelBlock pixels = basis.pixels(tile, channel);
    if (std::all_of(pixels.shift.begin(), pixels.shift.end(),
                    [](std::uint8_t s) { return s == 0; })) {
      return;
    }
    char* page = list.add(0, 0);
    for (std::size_t p = 0; p < pixels.shift.size(); ++p) {
      // 2^-127 of a step is negligible: the page's integers are signed.
      put(page, offsets(p), static_cast<std::int8_t>(std::min<int>(pixels.shift[p], 127)));
    }
  });
}

}  // namespace haarlight::relight
