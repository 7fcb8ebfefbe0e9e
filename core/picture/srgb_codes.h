// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <vector>

/// @file
/// 8-bit sRGB codes of linear light by a table: the codes that srgb_from_linear gives, rounded, at
/// a tenth of the time.

namespace haarlight {

class SrgbCodes {
 public:
  /// The one table.
  [[nodiscard]] static const SrgbCodes& table();

  /// round(255 srgb_from_linear(linear)), at least 0 and at most 255; of NaN 0. Pure.
  [[nodiscard]] std::uint8_t code(float linear) const noexcept {
    if (!(linear > kLeast)) {
      return 0;
    }
    if (linear >= 1.0F) {
      return 255;
    }
    // A piece holds at most one border: the codes are monotonic in the float's bits.
    const std::uint8_t below =
        first_[(std::bit_cast<std::uint32_t>(linear) - kFirstBits) >> kPieceBits];
    return static_cast<std::uint8_t>(below + (linear >= borders_[below] ? 1 : 0));
  }

 private:
  static constexpr float kLeast = 0x1p-13F;   // 12.92 * 255 * this is below a half
  static constexpr unsigned kPieceBits = 16;  // 128 pieces per octave
  static constexpr std::uint32_t kFirstBits = std::bit_cast<std::uint32_t>(kLeast);

  SrgbCodes();
  /// By srgb_from_linear itself.
  [[nodiscard]] static int computed(std::uint32_t bits);

  std::vector<std::uint8_t> first_;   ///< each piece's lowest code
  std::array<float, 256> borders_{};  ///< [code]: the least value of code + 1
};

}  // namespace haarlight
