// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "relight/basis/huge_page_buffer.h"

/// @file
/// Rows of all pictures of a capture, in large pages: a pixel's values under successive lights
/// lie a row apart, and a thousand small pages would thrash the TLB.

namespace haarlight::relight {

class PixelBand {
 public:
  explicit PixelBand(std::size_t n_codes = 0) : bytes_(n_codes * sizeof(std::uint16_t)) {}
  [[nodiscard]] std::span<std::uint16_t> codes() const noexcept {
    return {reinterpret_cast<std::uint16_t*>(bytes_.bytes().data()),
            bytes_.bytes().size() / sizeof(std::uint16_t)};
  }

 private:
  HugePageBuffer bytes_;
};

}  // namespace haarlight::relight
