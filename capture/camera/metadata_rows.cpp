// SPDX-License-Identifier: Apache-2.0
#include "capture/camera/metadata_rows.h"

#include <algorithm>
#include <array>

#include "haarlight/core/error.h"

namespace haarlight::capture {

namespace {

constexpr int kBits = 96;
constexpr std::uint32_t kSync = 0xB2;
constexpr std::uint32_t kMixedFlag = 1;

using BitField = std::array<bool, kBits>;

void put_bits(BitField& bits, std::size_t first, std::size_t count, std::uint32_t value) {
  for (std::size_t i = 0; i < count; ++i) {
    bits[first + i] = ((value >> (count - 1 - i)) & 1U) != 0;
  }
}

std::uint32_t get_bits(const BitField& bits, std::size_t first, std::size_t count) {
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < count; ++i) {
    value = (value << 1U) | (bits[first + i] ? 1U : 0U);
  }
  return value;
}

/// CRC-16/CCITT-FALSE (x^16 + x^12 + x^5 + 1, init 0xFFFF) of the tag's 4 bytes and the flags
/// byte.
std::uint32_t crc16(std::uint32_t tag, std::uint32_t flags) {
  std::uint32_t crc = 0xFFFF;
  const std::array<std::uint32_t, 5> bytes{tag >> 24U, (tag >> 16U) & 0xFFU,
                                           (tag >> 8U) & 0xFFU, tag & 0xFFU, flags};
  for (const std::uint32_t byte : bytes) {
    crc ^= byte << 8U;
    for (int i = 0; i < 8; ++i) {
      crc = ((crc & 0x8000U) != 0 ? (crc << 1U) ^ 0x1021U : crc << 1U) & 0xFFFFU;
    }
  }
  return crc;
}

}  // namespace

int tag_block_side(int width, int n_rows) noexcept {
  for (int side = std::min(width, n_rows); side >= 2; --side) {
    if (static_cast<std::int64_t>(width / side) * (n_rows / side) >= kBits) {
      return side;
    }
  }
  return 0;
}

void encode_metadata_rows(ImageView<std::uint16_t> rows, FrameTag tag, std::uint16_t black,
                          std::uint16_t white) {
  const int side = tag_block_side(rows.width(), rows.height());
  HAARLIGHT_EXPECTS(side > 0, "metadata rows large enough for 96 blocks of 2 x 2");
  const std::uint32_t flags = tag.is_mixed ? kMixedFlag : 0;
  BitField bits{};
  put_bits(bits, 0, 8, kSync);
  put_bits(bits, 8, 32, tag.tag);
  put_bits(bits, 40, 8, flags);
  put_bits(bits, 48, 32, ~tag.tag);
  put_bits(bits, 80, 16, crc16(tag.tag, flags));
  const int columns = rows.width() / side;
  for (int y = 0; y < rows.height(); ++y) {
    for (int x = 0; x < rows.width(); ++x) {
      const int i = (y / side) * columns + x / side;
      const bool is_white =
          x / side < columns && i < kBits && bits[static_cast<std::size_t>(i)];
      rows(y, x) = is_white ? white : black;
    }
  }
}

std::optional<FrameTag> decode_metadata_rows(ImageView<const std::uint16_t> rows) {
  const int side = tag_block_side(rows.width(), rows.height());
  if (side == 0) {
    return std::nullopt;
  }
  const int columns = rows.width() / side;
  std::array<std::uint64_t, kBits> sums{};
  for (int i = 0; i < kBits; ++i) {
    std::uint64_t sum = 0;
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        sum += rows((i / columns) * side + y, (i % columns) * side + x);
      }
    }
    sums[static_cast<std::size_t>(i)] = sum;
  }
  const auto [darkest, brightest] = std::minmax_element(sums.begin(), sums.end());
  const std::uint64_t middle = (*darkest + *brightest) / 2;
  BitField bits{};
  for (std::size_t i = 0; i < kBits; ++i) {
    bits[i] = sums[i] > middle;
  }
  const std::uint32_t tag = get_bits(bits, 8, 32);
  const std::uint32_t flags = get_bits(bits, 40, 8);
  const bool is_valid = get_bits(bits, 0, 8) == kSync && get_bits(bits, 48, 32) == ~tag &&
                        get_bits(bits, 80, 16) == crc16(tag, flags) &&
                        (flags & ~kMixedFlag) == 0;
  if (!is_valid) {
    return std::nullopt;
  }
  return FrameTag{.tag = tag, .is_mixed = (flags & kMixedFlag) != 0};
}

}  // namespace haarlight::capture
