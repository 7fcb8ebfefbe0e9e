// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// Vector width for loops over pixels: as wide as the machine has.

#include <algorithm>
#include <atomic>

#include "core/vector_clones.h"

#if defined(__x86_64__)
#define HAARLIGHT_FIT_X86 1
#else
#define HAARLIGHT_FIT_X86 0
#endif

#define HAARLIGHT_WIDER HAARLIGHT_CLONES("arch=x86-64-v4", "avx2")

namespace haarlight::relight {

/// Which loops of lanes.inc run.
enum class VectorWidth { portable, avx2, avx512 };

/// The widest that this machine has.
[[nodiscard]] inline VectorWidth machine_vector_width() {
#if HAARLIGHT_FIT_X86
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq")) {
    return VectorWidth::avx512;
  }
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    return VectorWidth::avx2;
  }
#endif
  return VectorWidth::portable;
}

/// The widest in use: less than the machine's if a test requests it.
inline std::atomic<VectorWidth> widest_vectors = VectorWidth::avx512;

[[nodiscard]] inline VectorWidth vector_width() {
  static const VectorWidth kMachines = machine_vector_width();
  return std::min(kMachines, widest_vectors.load(std::memory_order_relaxed));
}

}  // namespace haarlight::relight
