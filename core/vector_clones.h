// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// Clones of a plain loop for wider vectors, chosen when the program starts:
///
///     HAARLIGHT_CLONES("avx2") void add(const float* a, std::size_t n, float* sums) {
///
/// Nothing is contracted or reordered, so every width gives the same bits. One loop, and none
/// beside, where the compiler or a sanitizer cannot have it.

#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define HAARLIGHT_CLONES(...) [[gnu::target_clones(__VA_ARGS__, "default"), gnu::flatten]]
#else
#define HAARLIGHT_CLONES(...)
#endif
