// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/pixel_unpack.h"

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

using Row = const std::byte*;
using Words = std::span<std::uint16_t>;

/// A group of samples and the bytes they are packed into.
struct Group {
  std::size_t samples = 1;
  std::size_t bytes = 1;
};

Group group_of(PixelPacking packing) {
  switch (packing) {
    case PixelPacking::bytes:
    case PixelPacking::luma_plane:
      return {1, 1};
    case PixelPacking::words_le:
    case PixelPacking::words_be:
      return {1, 2};
    case PixelPacking::luma_even:
    case PixelPacking::luma_odd:
      return {2, 4};
    case PixelPacking::mipi10:
      return {4, 5};
    case PixelPacking::mipi12:
      return {2, 3};
    case PixelPacking::mipi14:
      return {4, 7};
    case PixelPacking::bits10:
      return {4, 5};
    case PixelPacking::ipu3:
      return {25, 32};
    case PixelPacking::motion_jpeg:
      break;
  }
  return {1, 0};
}

unsigned at(Row row, std::size_t i) { return std::to_integer<unsigned>(row[i]); }

std::uint16_t word(unsigned value) { return static_cast<std::uint16_t>(value); }

/// Calls write(i, row of the group, n samples of it) for every group; only the last may be
/// partial.
template <std::size_t kSamples, std::size_t kBytes, class Unpack>
std::uint16_t unpack_groups(Row row, Words words, Unpack unpack) {
  std::uint16_t all = 0;
  const std::size_t n_whole = words.size() / kSamples;
  for (std::size_t g = 0; g < n_whole; ++g) {
    std::uint16_t* out = words.data() + g * kSamples;
    unpack(row + g * kBytes, out);
    for (std::size_t i = 0; i < kSamples; ++i) {
      all = word(all | unsigned{out[i]});
    }
  }
  std::uint16_t rest[kSamples] = {};
  const std::size_t n_rest = words.size() - n_whole * kSamples;
  if (n_rest > 0) {
    unpack(row + n_whole * kBytes, rest);
  }
  for (std::size_t i = 0; i < n_rest; ++i) {
    words[n_whole * kSamples + i] = rest[i];
    all = word(all | unsigned{rest[i]});
  }
  return all;
}

/// Every kStep-th byte from kFirst, for 8-bit samples.
template <std::size_t kStep, std::size_t kFirst>
std::uint16_t unpack_bytes(Row row, Words words) {
  for (std::size_t x = 0; x < words.size(); ++x) {
    words[x] = word(at(row, kStep * x + kFirst));
  }
  return 0xFF;  // 8-bit samples cannot exceed their format
}

template <std::size_t kLow, std::size_t kHigh>
std::uint16_t unpack_words(Row row, Words words) {
  unsigned all = 0;
  for (std::size_t x = 0; x < words.size(); ++x) {
    const unsigned value = at(row, 2 * x + kLow) | at(row, 2 * x + kHigh) << 8U;
    words[x] = word(value);
    all |= value;
  }
  return word(all);
}

std::uint16_t unpack_mipi10(Row row, Words words) {
  return unpack_groups<4, 5>(row, words, [](Row b, std::uint16_t* out) {
    const unsigned low = at(b, 4);
    out[0] = word(at(b, 0) << 2U | (low & 3U));
    out[1] = word(at(b, 1) << 2U | (low >> 2U & 3U));
    out[2] = word(at(b, 2) << 2U | (low >> 4U & 3U));
    out[3] = word(at(b, 3) << 2U | low >> 6U);
  });
}

std::uint16_t unpack_mipi12(Row row, Words words) {
  return unpack_groups<2, 3>(row, words, [](Row b, std::uint16_t* out) {
    out[0] = word(at(b, 0) << 4U | (at(b, 2) & 15U));
    out[1] = word(at(b, 1) << 4U | at(b, 2) >> 4U);
  });
}

std::uint16_t unpack_mipi14(Row row, Words words) {
  return unpack_groups<4, 7>(row, words, [](Row b, std::uint16_t* out) {
    // The low 6 bits of the four samples form one 24-bit number, low byte first.
    const unsigned low = at(b, 4) | at(b, 5) << 8U | at(b, 6) << 16U;
    out[0] = word(at(b, 0) << 6U | (low & 63U));
    out[1] = word(at(b, 1) << 6U | (low >> 6U & 63U));
    out[2] = word(at(b, 2) << 6U | (low >> 12U & 63U));
    out[3] = word(at(b, 3) << 6U | low >> 18U);
  });
}

std::uint16_t unpack_bits10(Row row, Words words) {
  return unpack_groups<4, 5>(row, words, [](Row b, std::uint16_t* out) {
    out[0] = word(at(b, 0) << 2U | at(b, 1) >> 6U);
    out[1] = word((at(b, 1) & 63U) << 4U | at(b, 2) >> 4U);
    out[2] = word((at(b, 2) & 15U) << 6U | at(b, 3) >> 2U);
    out[3] = word((at(b, 3) & 3U) << 8U | at(b, 4));
  });
}

std::uint16_t unpack_ipu3(Row row, Words words) {
  return unpack_groups<25, 32>(row, words, [](Row b, std::uint16_t* out) {
    for (std::size_t i = 0; i < 25; ++i) {
      const std::size_t bit = 10 * i;
      const unsigned pair = at(b, bit / 8) | at(b, bit / 8 + 1) << 8U;
      out[i] = word(pair >> (bit % 8) & 1023U);
    }
  });
}

std::uint16_t unpack_row(PixelPacking packing, Row row, Words words) {
  switch (packing) {
    case PixelPacking::bytes:
    case PixelPacking::luma_plane:
      return unpack_bytes<1, 0>(row, words);
    case PixelPacking::luma_even:
      return unpack_bytes<2, 0>(row, words);
    case PixelPacking::luma_odd:
      return unpack_bytes<2, 1>(row, words);
    case PixelPacking::words_le:
      return unpack_words<0, 1>(row, words);
    case PixelPacking::words_be:
      return unpack_words<1, 0>(row, words);
    case PixelPacking::mipi10:
      return unpack_mipi10(row, words);
    case PixelPacking::mipi12:
      return unpack_mipi12(row, words);
    case PixelPacking::mipi14:
      return unpack_mipi14(row, words);
    case PixelPacking::bits10:
      return unpack_bits10(row, words);
    case PixelPacking::ipu3:
      return unpack_ipu3(row, words);
    case PixelPacking::motion_jpeg:
      break;
  }
  throw_contract_violation("packing", "a picture has no rows of samples", __FILE__, __LINE__);
}

}  // namespace

std::size_t packed_row_bytes(PixelPacking packing, int width) noexcept {
  const Group group = group_of(packing);
  const auto n = static_cast<std::size_t>(width);
  return (n + group.samples - 1) / group.samples * group.bytes;
}

std::size_t packed_frame_bytes(PixelPacking packing, int width, int height,
                               std::size_t stride) noexcept {
  return height < 1
             ? 0
             : stride * static_cast<std::size_t>(height - 1) + packed_row_bytes(packing, width);
}

std::uint16_t unpack_pixels(PixelPacking packing, std::span<const std::byte> source,
                            std::size_t stride, ImageView<std::uint16_t> words) {
  HAARLIGHT_EXPECTS(stride >= packed_row_bytes(packing, words.width()), "stride");
  HAARLIGHT_EXPECTS(
      source.size() >= packed_frame_bytes(packing, words.width(), words.height(), stride),
      "bytes of a whole frame");
  unsigned all = 0;
  for (int y = 0; y < words.height(); ++y) {
    all |=
        unpack_row(packing, source.data() + stride * static_cast<std::size_t>(y), words.row(y));
  }
  return word(all);
}

}  // namespace haarlight::capture
