// SPDX-License-Identifier: Apache-2.0
#include "core/npy.h"

#include <cstdint>
#include <functional>
#include <numeric>
#include <string>

#include "core/binary_writer.h"
#include "haarlight/core/error.h"

namespace haarlight {

void write_npy(const std::filesystem::path& path, std::span<const std::size_t> shape,
               const std::vector<double>& values) {
  HAARLIGHT_EXPECTS(std::accumulate(shape.begin(), shape.end(), std::size_t{1},
                                    std::multiplies<>()) == values.size(),
                    "a value for each index");
  std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': (";
  for (const std::size_t side : shape) {
    header += std::to_string(side) + ", ";
  }
  header += "), }";
  constexpr std::size_t kBefore = 10;  // magic, version, the header's length
  constexpr std::size_t kAligned = 64;
  const std::size_t end = (kBefore + header.size() + kAligned) / kAligned * kAligned;
  header.resize(end - kBefore - 1, ' ');
  header += '\n';
  HAARLIGHT_EXPECTS(header.size() <= UINT16_MAX, "few dimensions");

  BinaryWriter file(path);
  constexpr std::string_view kMagic("\x93NUMPY\x01\x00", 8);
  file.put_text(kMagic);
  file.put(static_cast<std::uint16_t>(header.size()));
  file.put_text(header);
  file.put_all(values);
  file.commit();
}

}  // namespace haarlight
