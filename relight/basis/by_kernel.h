// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/basis/relight_kernels.h"

/// @file
/// A plain loop, compiled for each kind of vectors and run by the kernels in use:
///
///     struct Add {
///       [[gnu::always_inline]] static inline void run(const float* a, std::size_t n, float* to) {
///     ...
///     run_by_kernel<Add>(a, n, to);
///
/// Nothing is contracted or reordered, so every width gives the same bits. Arguments are
/// numbers, pointers and spans.

#if defined(__x86_64__)
#define HAARLIGHT_AVX512 "avx512f,avx512bw,avx512dq,avx512vl"
#endif

namespace haarlight::relight {

#if defined(__x86_64__)
template <class Loop, class... Arguments>
[[gnu::target(HAARLIGHT_AVX512), gnu::flatten, gnu::noinline]] auto run_by_avx512(
    Arguments... arguments) {
  return Loop::run(arguments...);
}
template <class Loop, class... Arguments>
[[gnu::target("avx2"), gnu::flatten, gnu::noinline]] auto run_by_avx2(Arguments... arguments) {
  return Loop::run(arguments...);
}
#endif

template <class Loop, class... Arguments>
auto run_by_kernel(Arguments... arguments) {
#if defined(__x86_64__)
  const KernelCode code = best_kernel_code();
  if (has_avx512(code)) {
    return run_by_avx512<Loop>(arguments...);
  }
  if (code != KernelCode::portable) {
    return run_by_avx2<Loop>(arguments...);
  }
#endif
  return Loop::run(arguments...);
}

}  // namespace haarlight::relight
