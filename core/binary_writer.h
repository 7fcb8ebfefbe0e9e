// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <filesystem>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include "haarlight/core/files.h"

/// @file
/// Numbers and text that go to a file piece by piece, little-endian; the file appears when it is
/// whole.

namespace haarlight {

static_assert(std::endian::native == std::endian::little, "numbers are written as they lie");

class BinaryWriter {
 public:
  /// @throws Error  it cannot be created; put() and commit(): it cannot be written
  explicit BinaryWriter(const std::filesystem::path& path) : file_(path) {}
  /// A number, or an array of them without padding.
  template <class T>
  void put(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    put_bytes(std::as_bytes(std::span<const T, 1>(&value, 1)));
  }
  template <class T>
  void put_all(const std::vector<T>& values) {
    put_bytes(std::as_bytes(std::span<const T>(values)));
  }
  void put_text(std::string_view text) { put_bytes(std::as_bytes(std::span(text))); }
  void put_bytes(std::span<const std::byte> bytes) {
    bytes_.insert(bytes_.end(), bytes.begin(), bytes.end());
    if (bytes_.size() >= kPieceBytes) {
      flush();
    }
  }
  void commit() {
    flush();
    file_.commit();
  }

 private:
  void flush() {
    file_.append(bytes_);
    bytes_.clear();
  }

  static constexpr std::size_t kPieceBytes = std::size_t{1} << 20U;
  PendingFile file_;
  std::vector<std::byte> bytes_;
};

}  // namespace haarlight
