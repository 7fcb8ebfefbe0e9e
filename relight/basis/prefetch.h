// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

/// @file
/// Asking for memory ahead of where a loop reads it one line after the other.

namespace haarlight {

/// Without it memory is read at two thirds of its rate (the hardware's prefetchers stop at
/// every page). 4 KB ahead into the second cache, which has room for more requests at a time, 1
/// KB ahead into the first: the best of 0 to 8 KB and 0 to 256 KB, on machines whose cores can
/// read less than the memory gives and on others (bench/relight/kernels.cpp). Once a line of 64
/// bytes; several lines at once stall the loop (Haar transform: a tenth slower).
inline void prefetch_ahead(const void* from) noexcept {
  constexpr std::size_t kNearBytes = 1024;
  constexpr std::size_t kFarBytes = 4096;
  const auto* bytes = static_cast<const char*>(from);
  __builtin_prefetch(bytes + kFarBytes, 0, 2);
  __builtin_prefetch(bytes + kNearBytes);
}

}  // namespace haarlight
