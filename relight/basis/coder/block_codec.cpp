// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/coder/block_codec.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <memory>
#include <numeric>

#include <xxhash.h>
#include <zstd.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr int kZstdLevel = 12;  // twin: 9 is 0.6 % larger; 19 is 4.5 % smaller, twice as slow

struct CompressorFree {
  void operator()(ZSTD_CCtx* context) const noexcept { ZSTD_freeCCtx(context); }
};

std::uint32_t zigzag(std::int32_t v) noexcept {
  return (static_cast<std::uint32_t>(v) << 1U) ^ (v < 0 ? 0xffffffffU : 0U);
}

std::int32_t unzigzag(std::uint32_t z) noexcept {
  return static_cast<std::int32_t>((z >> 1U) ^ (0U - (z & 1U)));
}

/// Byte planes of numbers, lowest bytes first, appended to `raw`.
void append_planes(std::vector<std::byte>& raw, std::span<const std::uint32_t> numbers) {
  const std::size_t start = raw.size();
  raw.resize(start + 4 * numbers.size());
  const std::uint32_t all =
      std::accumulate(numbers.begin(), numbers.end(), std::uint32_t{0}, std::bit_or<>());
  for (unsigned plane = 0; plane < 4; ++plane) {
    if (((all >> (8 * plane)) & 0xffU) == 0) {
      continue;  // zeros already
    }
    std::byte* to = raw.data() + start + plane * numbers.size();
    for (std::size_t i = 0; i < numbers.size(); ++i) {
      to[i] = static_cast<std::byte>((numbers[i] >> (8 * plane)) & 0xffU);
    }
  }
}

std::vector<std::uint32_t> read_planes(std::span<const std::byte> raw) {
  const std::size_t n = raw.size() / 4;
  std::vector<std::uint32_t> numbers(n);
  const auto* lowest = reinterpret_cast<const std::uint8_t*>(raw.data());
  std::uint32_t* to = numbers.data();
  for (std::size_t i = 0; i < n; ++i) {  // one pass, which compilers make vectors of
    to[i] = std::uint32_t{lowest[i]} | std::uint32_t{lowest[n + i]} << 8U |
            std::uint32_t{lowest[2 * n + i]} << 16U | std::uint32_t{lowest[3 * n + i]} << 24U;
  }
  return numbers;
}

/// How bytes are searched for repeats.
enum class Search {
  thorough,
  long_repeats,  ///< of 6 bytes and more within 32 kB: shorter or farther ones, which chance
                 ///< brings in noise, cost as many bits as they save
  none,          ///< only byte frequencies carry information
};

void set_search(ZSTD_CCtx* context, Search search) {
  constexpr int kQuick = 7;
  // Level 1 ignores matches below 7 bytes.
  const int level =
      search == Search::thorough ? kZstdLevel : (search == Search::none ? 1 : kQuick);
  ZSTD_CCtx_reset(context, ZSTD_reset_session_and_parameters);
  ZSTD_CCtx_setParameter(context, ZSTD_c_compressionLevel, level);
  if (search == Search::long_repeats) {
    constexpr int kLogBytes = 15;
    for (const ZSTD_cParameter log : {ZSTD_c_windowLog, ZSTD_c_chainLog, ZSTD_c_hashLog}) {
      ZSTD_CCtx_setParameter(context, log, kLogBytes);
    }
    ZSTD_CCtx_setParameter(context, ZSTD_c_strategy, ZSTD_lazy2);
    ZSTD_CCtx_setParameter(context, ZSTD_c_searchLog, 4);
    ZSTD_CCtx_setParameter(context, ZSTD_c_minMatch, 6);
  }
}

/// Of each thread, used again for every block: a context's tables and room for what zstd may
/// write at most cost as much to allocate as a small block to pack.
struct Deflater {
  std::unique_ptr<ZSTD_CCtx, CompressorFree> context{ZSTD_createCCtx()};
  std::unique_ptr<std::byte[]> room;  // NOLINT(modernize-avoid-c-arrays): not zeroed
  std::size_t n_room = 0;
};

std::vector<std::byte> deflate(std::span<const std::byte> raw,
                               Search search = Search::thorough) {
  thread_local Deflater deflater;
  ZSTD_CCtx* context = deflater.context.get();
  HAARLIGHT_EXPECTS(context != nullptr, "zstd: no memory");
  set_search(context, search);
  const std::size_t most = ZSTD_compressBound(raw.size());
  if (deflater.n_room < most) {
    deflater.room = std::make_unique_for_overwrite<std::byte[]>(most);
    deflater.n_room = most;
  }
  std::byte* packed = deflater.room.get();
  const std::size_t size = ZSTD_compress2(context, packed, most, raw.data(), raw.size());
  HAARLIGHT_EXPECTS(ZSTD_isError(size) == 0, "zstd: compression failed");
  return {packed, packed + size};
}

[[noreturn]] void throw_damaged(const std::string& what, const std::string& where) {
  throw Error(what, where, "the file is damaged: make it again with haarlight compress");
}

std::vector<std::byte> inflate(std::span<const std::byte> packed, std::size_t n_bytes,
                               const std::string& where) {
  // The stated size is checked before memory is allocated: a damaged file cannot claim
  // terabytes.
  if (ZSTD_getFrameContentSize(packed.data(), packed.size()) != n_bytes) {
    throw_damaged("a block's unpacked size differs from what the index says", where);
  }
  std::vector<std::byte> raw(n_bytes);
  const std::size_t size =
      ZSTD_decompress(raw.data(), raw.size(), packed.data(), packed.size());
  if (ZSTD_isError(size) != 0 || size != n_bytes) {
    throw_damaged("a block cannot be unpacked", where);
  }
  return raw;
}

constexpr unsigned kMostLowBits = 24;

/// How many low bits of a row's numbers are noise: what remains above them has a mean magnitude
/// of 8 to 16. Bits below a tenth of a distribution's width are practically random.
unsigned noise_bits(std::span<const std::int32_t> row) {
  double sum = 0.0;
  for (const std::int32_t v : row) {
    sum += std::abs(static_cast<double>(v));
  }
  const double mean = sum / static_cast<double>(row.size());
  return mean < 16.0 ? 0U
                     : std::min(kMostLowBits, static_cast<unsigned>(std::ilogb(mean)) - 3U);
}

std::size_t bytes_of_bits(std::size_t n_numbers, unsigned n_bits) {
  return (n_numbers * n_bits + 7) / 8;
}

/// The lowest bits of each number one after the other, lowest first, padded to whole bytes.
void append_bits(std::vector<std::byte>& to, std::span<const std::int32_t> numbers,
                 unsigned n_bits) {
  const std::uint64_t mask = (std::uint64_t{1} << n_bits) - 1;
  std::uint64_t held = 0;
  unsigned n_held = 0;
  const std::size_t end = to.size() + bytes_of_bits(numbers.size(), n_bits);
  for (const std::int32_t v : numbers) {
    held |= (static_cast<std::uint64_t>(static_cast<std::uint32_t>(v)) & mask) << n_held;
    n_held += n_bits;
    for (; n_held >= 8; n_held -= 8) {
      to.push_back(static_cast<std::byte>(held & 0xffU));
      held >>= 8U;
    }
  }
  if (to.size() < end) {
    to.push_back(static_cast<std::byte>(held & 0xffU));
  }
}

/// @param bytes  as many as append_bits() made
void read_bits(std::span<const std::byte> bytes, unsigned n_bits,
               std::span<std::int32_t> numbers) {
  const std::uint64_t mask = (std::uint64_t{1} << n_bits) - 1;
  std::uint64_t held = 0;
  unsigned n_held = 0;
  std::size_t at = 0;
  for (std::int32_t& v : numbers) {
    for (; n_held < n_bits; n_held += 8) {
      held |= std::to_integer<std::uint64_t>(bytes[at++]) << n_held;
    }
    v = static_cast<std::int32_t>(held & mask);
    held >>= n_bits;
    n_held -= n_bits;
  }
}

}  // namespace

std::vector<std::byte> encode_sparse(const SparseBlock& block, BlockContent content) {
  HAARLIGHT_EXPECTS(block.cell.size() == block.value.size(), "one value per cell");
  if (block.cell.empty()) {
    return {};
  }
  std::vector<std::uint32_t> numbers(block.cell.size());
  std::uint32_t next = 0;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    HAARLIGHT_EXPECTS(block.cell[i] >= next, "cells increase");
    numbers[i] = block.cell[i] - next;
    next = block.cell[i] + 1;
  }
  std::vector<std::byte> raw;
  raw.reserve(8 * numbers.size());
  append_planes(raw, numbers);
  std::transform(block.value.begin(), block.value.end(), numbers.begin(), zigzag);
  append_planes(raw, numbers);
  return deflate(raw, content == BlockContent::dense ? Search::long_repeats : Search::thorough);
}

SparseBlock decode_sparse(std::span<const std::byte> bytes, std::size_t n_entries,
                          std::size_t n_cells, const std::string& where) {
  if (n_entries > n_cells || n_cells > std::numeric_limits<std::uint32_t>::max()) {
    throw_damaged("the index states more entries than a block has cells", where);
  }
  SparseBlock block;
  if (n_entries == 0) {
    if (!bytes.empty()) {
      throw_damaged("a block without entries has bytes", where);
    }
    return block;
  }
  const std::vector<std::byte> raw = inflate(bytes, 8 * n_entries, where);
  const std::span<const std::byte> all(raw);
  block.cell = read_planes(all.first(4 * n_entries));
  std::uint64_t next = 0;
  for (std::uint32_t& cell : block.cell) {
    next += cell;
    if (next >= n_cells) {
      throw_damaged("a coefficient lies outside its block", where);
    }
    cell = static_cast<std::uint32_t>(next);
    ++next;
  }
  const std::vector<std::uint32_t> numbers = read_planes(all.last(4 * n_entries));
  block.value.resize(n_entries);
  std::transform(numbers.begin(), numbers.end(), block.value.begin(), unzigzag);
  return block;
}

std::vector<std::byte> encode_pixels(const PixelBlock& block) {
  const std::size_t n_pixels = block.shift.size();
  HAARLIGHT_EXPECTS(block.gain.size() == n_pixels, "one gain per pixel");
  const auto is_zero = [](auto v) { return v == 0; };
  if (std::all_of(block.shift.begin(), block.shift.end(), is_zero) &&
      std::all_of(block.gain.begin(), block.gain.end(), is_zero)) {
    return {};
  }
  std::vector<std::byte> raw(n_pixels);
  std::memcpy(raw.data(), block.shift.data(), n_pixels);
  std::vector<std::uint32_t> numbers(n_pixels);
  std::uint32_t before = 0;
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const auto gain = static_cast<std::uint32_t>(block.gain[p]);
    numbers[p] = zigzag(static_cast<std::int32_t>(gain - before));
    before = gain;
  }
  append_planes(raw, numbers);
  numbers.resize(block.plate.size());
  std::transform(block.plate.begin(), block.plate.end(), numbers.begin(),
                 [](float v) { return std::bit_cast<std::uint32_t>(v); });
  append_planes(raw, numbers);
  return deflate(raw);
}

PixelBlock decode_pixels(std::span<const std::byte> bytes, std::size_t n_pixels,
                         std::size_t n_plate, const std::string& where) {
  PixelBlock block;
  if (bytes.empty()) {
    block.shift.assign(n_pixels, 0);
    block.gain.assign(n_pixels, 0);
    block.plate.assign(n_plate, 0.0F);
    return block;
  }
  const std::vector<std::byte> raw = inflate(bytes, 5 * n_pixels + 4 * n_plate, where);
  const std::span<const std::byte> all(raw);
  block.shift.resize(n_pixels);
  std::memcpy(block.shift.data(), raw.data(), n_pixels);
  if (std::any_of(block.shift.begin(), block.shift.end(),
                  [](std::uint8_t s) { return s > kMostShift; })) {
    throw_damaged("a pixel's step is out of range", where);
  }
  block.gain.resize(n_pixels);
  std::uint32_t value = 0;
  const std::vector<std::uint32_t> gains = read_planes(all.subspan(n_pixels, 4 * n_pixels));
  std::transform(gains.begin(), gains.end(), block.gain.begin(), [&value](std::uint32_t n) {
    value += static_cast<std::uint32_t>(unzigzag(n));
    return static_cast<std::int32_t>(value);
  });
  const std::vector<std::uint32_t> plate = read_planes(all.subspan(5 * n_pixels));
  block.plate.resize(n_plate);
  std::transform(plate.begin(), plate.end(), block.plate.begin(),
                 [](std::uint32_t bits) { return std::bit_cast<float>(bits); });
  if (!std::all_of(block.plate.begin(), block.plate.end(),
                   [](float v) { return std::isfinite(v); })) {
    throw_damaged("the clean plate of a tile is not finite", where);
  }
  return block;
}

std::vector<std::byte> encode_floats(std::span<const float> values, std::size_t n_pixels) {
  std::vector<std::uint32_t> numbers(values.size());
  bool is_zero = true;
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(values[i]);
    const std::uint32_t before =
        i < n_pixels ? 0U : std::bit_cast<std::uint32_t>(values[i - n_pixels]);
    is_zero = is_zero && bits == 0;
    numbers[i] = zigzag(static_cast<std::int32_t>(bits - before));
  }
  if (is_zero) {
    return {};
  }
  std::vector<std::byte> raw;
  append_planes(raw, numbers);
  return deflate(raw);
}

std::vector<float> decode_floats(std::span<const std::byte> bytes, std::size_t n_rows,
                                 std::size_t n_pixels, const std::string& where) {
  std::vector<float> values(n_rows * n_pixels);
  if (bytes.empty()) {
    return values;
  }
  const std::vector<std::byte> raw = inflate(bytes, 4 * values.size(), where);
  const std::vector<std::uint32_t> numbers = read_planes(raw);
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    const std::uint32_t before =
        i < n_pixels ? 0U : std::bit_cast<std::uint32_t>(values[i - n_pixels]);
    values[i] = std::bit_cast<float>(before + static_cast<std::uint32_t>(unzigzag(numbers[i])));
  }
  return values;
}

namespace {

std::vector<std::byte> encode_rows(std::span<const std::int32_t> values, std::size_t n_pixels) {
  const std::size_t n_rows = values.size() / n_pixels;
  std::vector<std::byte> head(n_rows);
  std::vector<std::byte> low;
  std::vector<std::uint32_t> high(values.size());
  for (std::size_t r = 0; r < n_rows; ++r) {
    const std::span<const std::int32_t> row = values.subspan(r * n_pixels, n_pixels);
    const unsigned n_bits = noise_bits(row);
    head[r] = static_cast<std::byte>(n_bits);
    append_bits(low, row, n_bits);
    std::transform(row.begin(), row.end(),
                   high.begin() + static_cast<std::ptrdiff_t>(r * n_pixels),
                   [n_bits](std::int32_t v) { return zigzag(v >> n_bits); });
  }
  std::vector<std::byte> raw;
  append_planes(raw, high);
  const std::vector<std::byte> packed = deflate(raw, Search::none);
  std::vector<std::byte> bytes = std::move(head);
  bytes.insert(bytes.end(), low.begin(), low.end());
  bytes.insert(bytes.end(), packed.begin(), packed.end());
  return bytes;
}

std::vector<std::int32_t> decode_rows(std::span<const std::byte> bytes, std::size_t n_rows,
                                      std::size_t n_pixels, const std::string& where) {
  std::vector<std::int32_t> values(n_rows * n_pixels);
  std::size_t at = n_rows;
  for (std::size_t r = 0; r < std::min(n_rows, bytes.size()); ++r) {
    const auto n_bits = std::to_integer<unsigned>(bytes[r]);
    if (n_bits > kMostLowBits) {
      throw_damaged("a row states more low bits than numbers have", where);
    }
    at += bytes_of_bits(n_pixels, n_bits);
  }
  if (at > bytes.size()) {
    throw_damaged("a block ends before its low bits do", where);
  }
  const std::vector<std::uint32_t> high =
      read_planes(inflate(bytes.subspan(at), 4 * values.size(), where));
  at = n_rows;
  for (std::size_t r = 0; r < n_rows; ++r) {
    const auto n_bits = std::to_integer<unsigned>(bytes[r]);
    const std::size_t n_bytes = bytes_of_bits(n_pixels, n_bits);
    read_bits(bytes.subspan(at, n_bytes), n_bits,
              std::span(values).subspan(r * n_pixels, n_pixels));
    at += n_bytes;
    for (std::size_t p = 0; p < n_pixels; ++p) {
      const auto shifted = static_cast<std::uint32_t>(unzigzag(high[r * n_pixels + p]))
                           << n_bits;
      std::int32_t& value = values[r * n_pixels + p];
      value = static_cast<std::int32_t>(shifted | static_cast<std::uint32_t>(value));
    }
  }
  return values;
}

constexpr int kActivityClasses = 4;

/// How large the numbers around a pixel are, one class per octave: numbers of similar size
/// compress better together. The encoder's choice, stored in the file.
std::vector<std::uint8_t> activity_classes(std::span<const std::int32_t> values,
                                           std::size_t n_pixels) {
  std::vector<double> activity(n_pixels);
  for (std::size_t r = 0; r < values.size(); r += n_pixels) {
    double sum = 0.0;
    for (std::size_t p = 0; p < n_pixels; ++p) {
      sum += std::abs(static_cast<double>(values[r + p]));
    }
    const double mean = std::max(1.0, sum / static_cast<double>(n_pixels));
    for (std::size_t p = 0; p < n_pixels; ++p) {
      activity[p] += std::abs(static_cast<double>(values[r + p])) / mean;
    }
  }
  const std::size_t n_whole_rows = values.size() / n_pixels;
  const auto n_rows = static_cast<double>(n_whole_rows);
  std::vector<int> octave(n_pixels);
  std::transform(activity.begin(), activity.end(), octave.begin(), [n_rows](double a) {
    return static_cast<int>(std::lround(std::log2(std::max(a / n_rows, 1e-3))));
  });
  std::vector<int> sorted = octave;
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(n_pixels / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  std::vector<std::uint8_t> classes(n_pixels);
  std::transform(octave.begin(), octave.end(), classes.begin(), [&](int o) {
    return static_cast<std::uint8_t>(
        std::clamp(o - *middle + kActivityClasses / 2, 0, kActivityClasses - 1));
  });
  return classes;
}

/// The pixels of each class, in order.
std::vector<std::vector<std::size_t>> pixels_by_class(std::span<const std::uint8_t> classes) {
  std::vector<std::vector<std::size_t>> pixels(kActivityClasses);
  for (std::size_t p = 0; p < classes.size(); ++p) {
    pixels[classes[p]].push_back(p);
  }
  return pixels;
}

void append_part(std::vector<std::byte>& bytes, std::span<const std::byte> part) {
  for (unsigned i = 0; i < 4; ++i) {
    bytes.push_back(static_cast<std::byte>(part.size() >> (8 * i) & 0xffU));
  }
  bytes.insert(bytes.end(), part.begin(), part.end());
}

/// Takes a part off the front of `bytes`.
std::span<const std::byte> take_part(std::span<const std::byte>& bytes,
                                     const std::string& where) {
  std::size_t size = 0;
  for (unsigned i = 0; i < 4 && i < bytes.size(); ++i) {
    size |= std::to_integer<std::size_t>(bytes[i]) << (8 * i);
  }
  if (bytes.size() < 4 || bytes.size() - 4 < size) {
    throw_damaged("a block ends before its numbers do", where);
  }
  const std::span<const std::byte> part = bytes.subspan(4, size);
  bytes = bytes.subspan(4 + size);
  return part;
}

}  // namespace

std::vector<std::byte> encode_integers(std::span<const std::int32_t> values,
                                       std::size_t n_pixels) {
  if (std::all_of(values.begin(), values.end(), [](std::int32_t v) { return v == 0; })) {
    return {};
  }
  const std::size_t n_rows = values.size() / n_pixels;
  const std::vector<std::uint8_t> classes = activity_classes(values, n_pixels);
  std::vector<std::byte> bytes;
  append_part(bytes, deflate(std::as_bytes(std::span(classes))));
  std::vector<std::int32_t> part;
  for (const std::vector<std::size_t>& pixels : pixels_by_class(classes)) {
    if (pixels.empty()) {
      continue;
    }
    part.clear();
    for (std::size_t r = 0; r < n_rows; ++r) {
      for (const std::size_t p : pixels) {
        part.push_back(values[r * n_pixels + p]);
      }
    }
    append_part(bytes, encode_rows(part, pixels.size()));
  }
  return bytes;
}

std::vector<std::int32_t> decode_integers(std::span<const std::byte> bytes, std::size_t n_rows,
                                          std::size_t n_pixels, const std::string& where) {
  std::vector<std::int32_t> values(n_rows * n_pixels);
  if (bytes.empty()) {
    return values;
  }
  const std::vector<std::byte> map = inflate(take_part(bytes, where), n_pixels, where);
  std::vector<std::uint8_t> classes(n_pixels);
  std::memcpy(classes.data(), map.data(), n_pixels);
  if (std::any_of(classes.begin(), classes.end(),
                  [](std::uint8_t c) { return c >= kActivityClasses; })) {
    throw_damaged("a block names a class of pixels that there is not", where);
  }
  for (const std::vector<std::size_t>& pixels : pixels_by_class(classes)) {
    if (pixels.empty()) {
      continue;
    }
    const std::vector<std::int32_t> part =
        decode_rows(take_part(bytes, where), n_rows, pixels.size(), where);
    for (std::size_t r = 0, i = 0; r < n_rows; ++r) {
      for (const std::size_t p : pixels) {
        values[r * n_pixels + p] = part[i++];
      }
    }
  }
  return values;
}

std::uint64_t block_checksum(std::span<const std::byte> bytes) noexcept {
  return XXH3_64bits(bytes.data(), bytes.size());
}

}  // namespace haarlight::relight
