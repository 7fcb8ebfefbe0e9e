// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <span>
#include <string>
#include <string_view>

#include <gtest/gtest.h>

#include "haarlight/relight/basis/coder/block_codec.h"

/// @file
/// Basis files changed byte by byte, with checksums that are right again.

namespace haarlight::test {

inline std::uint64_t number_at(const std::string& bytes, std::size_t offset) {
  std::uint64_t value = 0;
  std::memcpy(&value, bytes.data() + offset, sizeof(value));
  return value;
}

inline void put_number(std::string& bytes, std::size_t offset, std::uint64_t value) {
  std::memcpy(bytes.data() + offset, &value, sizeof(value));
}

inline std::uint64_t checksum(std::string_view bytes) {
  return relight::block_checksum(std::as_bytes(std::span(bytes.data(), bytes.size())));
}

inline void sign_preamble(std::string& bytes) {
  put_number(bytes, 96, checksum(std::string_view(bytes).substr(0, 96)));
}

/// The file with another header text, all checksums right.
inline std::string with_header(std::string bytes,
                               const std::function<std::string(std::string)>& change) {
  const std::size_t offset = number_at(bytes, 24);
  const std::string header = change(bytes.substr(offset, number_at(bytes, 32)));
  bytes.resize(offset);  // the header stands last
  bytes += header;
  put_number(bytes, 16, bytes.size());
  put_number(bytes, 32, header.size());
  put_number(bytes, 40, checksum(header));
  sign_preamble(bytes);
  return bytes;
}

inline std::string replace(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

}  // namespace haarlight::test
