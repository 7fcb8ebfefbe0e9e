// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a transport file, its hash put right: planes of its size, or an Error.

#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "sim/transport_file.h"
#include "tests/memory_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  constexpr std::size_t kHash = 48;
  constexpr std::size_t kPlanes = 4096;
  std::vector<std::uint8_t> bytes(data, data + size);
  if (size >= kPlanes) {
    const std::string hash =
        haarlight::content_hash(std::as_bytes(std::span(bytes)).subspan(kPlanes));
    std::memcpy(bytes.data() + kHash, hash.data(), hash.size());
  }
  const haarlight::testing::MemoryFile file(bytes.data(), bytes.size());
  try {
    const haarlight::sim::Transport transport = haarlight::sim::Transport::open(file.path());
    static volatile float last = 0.0F;  // read, so that the address sanitizer sees its address
    for (int k = 0; k < transport.n_lights(); ++k) {
      const auto plane = transport.plane(k);
      last = plane(plane.height() - 1, plane.width() - 1, 0);
    }
    static_cast<void>(last);
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
