// SPDX-License-Identifier: Apache-2.0
#include "core/picture/srgb_codes.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "haarlight/core/picture/image_io.h"

namespace haarlight {

const SrgbCodes& SrgbCodes::table() {
  static const SrgbCodes codes;
  return codes;
}

int SrgbCodes::computed(std::uint32_t bits) {
  const float code = 255.0F * srgb_from_linear(std::bit_cast<float>(bits));
  return code > 0.0F ? static_cast<int>(std::lround(std::min(code, 255.0F))) : 0;
}

SrgbCodes::SrgbCodes() {
  const auto end = std::bit_cast<std::uint32_t>(1.0F);
  for (std::uint32_t bits = kFirstBits; bits < end; bits += 1U << kPieceBits) {
    first_.push_back(static_cast<std::uint8_t>(computed(bits)));
  }
  borders_.fill(std::numeric_limits<float>::infinity());
  for (int code = 0; code < 255; ++code) {
    std::uint32_t low = kFirstBits;  // its code is 0
    std::uint32_t high = end;        // its code is 255
    while (high - low > 1) {
      const std::uint32_t middle = low + (high - low) / 2;
      (computed(middle) > code ? high : low) = middle;
    }
    borders_.at(static_cast<std::size_t>(code)) = std::bit_cast<float>(high);
  }
}

}  // namespace haarlight
