// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <memory>
#include <span>

/// @file
/// A large buffer for repeated reading: straight from the system, in 2 MB pages where
/// available.

namespace haarlight::relight {

/// Zeroed bytes. Pages that are never written take no memory.
class HugePageBuffer {
 public:
  HugePageBuffer() = default;
  /// @throws std::bad_alloc
  explicit HugePageBuffer(std::size_t n_bytes);
  [[nodiscard]] std::span<std::byte> bytes() const noexcept {
    return {bytes_.get(), bytes_.get_deleter().n_bytes};
  }

 private:
  struct Unmap {
    std::size_t n_bytes;
    void operator()(std::byte* bytes) const noexcept;
  };
  std::unique_ptr<std::byte, Unmap> bytes_{nullptr, Unmap{0}};
};

}  // namespace haarlight::relight
