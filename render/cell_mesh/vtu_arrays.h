// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

/// @file
/// The bytes of VTK's XML arrays: raw or base64, plain or in blocks of zlib.

namespace haarlight::render {

/// What the file's first element says of all its arrays.
struct ArrayCoding {
  std::endian order = std::endian::little;  ///< of the sizes before the values, too
  bool has_wide_sizes = false;              ///< UInt64 instead of UInt32
  bool is_compressed = false;
};

/// What one array must be.
struct ArraySize {
  std::optional<std::size_t> n_bytes;  ///< nothing: whatever it says
  std::size_t most_bytes = 0;          ///< no more is taken, whatever it says
};

/// @param text    begins at the array's sizes; what follows the array is not looked at
/// @throws Error  without its location: cut short, not base64, not zlib, or another size
[[nodiscard]] std::string decode_array(std::string_view text, bool is_base64,
                                       const ArrayCoding& coding, const ArraySize& size);

}  // namespace haarlight::render
