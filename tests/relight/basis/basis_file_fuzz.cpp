// SPDX-License-Identifier: Apache-2.0
/// @file
/// The basis file's preamble, header, index and blocks from arbitrary bytes. The checksums are
/// put right first, so that what lies behind them is reached.

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/relight/basis/basis_file.h"

namespace {

using haarlight::relight::BasisFile;
using haarlight::relight::block_checksum;

std::uint64_t number_at(const std::vector<std::byte>& bytes, std::size_t offset) {
  std::uint64_t value = 0;
  std::memcpy(&value, bytes.data() + offset, sizeof(value));
  return value;
}

void put_number(std::vector<std::byte>& bytes, std::size_t offset, std::uint64_t value) {
  std::memcpy(bytes.data() + offset, &value, sizeof(value));
}

void sign(std::vector<std::byte>& bytes) {
  if (bytes.size() < 104) {
    return;
  }
  put_number(bytes, 16, bytes.size());
  for (const std::size_t part : {24U, 48U, 72U}) {
    const std::uint64_t offset = number_at(bytes, part);
    const std::uint64_t size = number_at(bytes, part + 8);
    if (offset <= bytes.size() && size <= bytes.size() - offset) {
      put_number(bytes, part + 16, block_checksum(std::span(bytes).subspan(offset, size)));
    }
  }
  put_number(bytes, 96, block_checksum(std::span(bytes).first(96)));
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr std::size_t kMostValues = std::size_t{1} << 24U;  // of a tile: 128 MB and more
  std::vector<std::byte> bytes(size);
  if (size > 0) {
    std::memcpy(bytes.data(), data, size);
  }
  sign(bytes);
  try {
    const BasisFile basis = BasisFile::from_bytes(bytes, "fuzz");
    const auto side = static_cast<std::size_t>(basis.header().tile);
    if (basis.n_tiles() > 64 ||
        side * side * static_cast<std::size_t>(basis.header().dims.n_lights) > kMostValues) {
      return 0;
    }
    for (int t = 0; t < basis.n_tiles(); ++t) {
      for (int c = 0; c < basis.header().dims.channels; ++c) {
        (void)basis.decode_tile(t, c);
      }
    }
  } catch (const haarlight::Error&) {
    return 0;  // the only way out for bad bytes
  }
  return 0;
}
