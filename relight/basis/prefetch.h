// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>

/// @file
/// Prefetches memory ahead of a loop that reads it sequentially.

namespace haarlight::relight {

/// Without it memory is read at two thirds of its rate (the hardware's prefetchers stop at
/// every page). 4 KB ahead into the L2 cache, which can track more requests at a time, 1 KB
/// ahead into L1: the best of 0 to 8 KB and 0 to 256 KB, on machines with and without cores
/// that saturate the memory (bench/relight/kernels.cpp). Once per 64-byte line; several lines
/// at once stall the loop (Haar transform: 10 % slower).
inline void prefetch_ahead(const void* from) noexcept {
  constexpr std::size_t kNearBytes = 1024;
  constexpr std::size_t kFarBytes = 4096;
  const auto* bytes = static_cast<const char*>(from);
  __builtin_prefetch(bytes + kFarBytes, 0, 2);
  __builtin_prefetch(bytes + kNearBytes);
}

}  // namespace haarlight::relight
