#pragma once

#include <span>

/// @file
/// The Haar transform of haar.h for many arrays at once: the lights of many pixels. Memory is
/// the limit: one reading, one writing past the caches, all levels in between in the first
/// cache. Same additions in the same order as haar_forward and haar_inverse: the same bits.
/// Method and figures: docs/numerics/haar.md, "Many arrays".

namespace haarlight {

/// Every n x n array of `in`, one after the other, into the same place of `out`. In parallel.
/// @param in, out  equal sizes, a multiple of n * n; the same memory or apart
/// @throws ContractViolation  n no power of two up to 1024, other sizes
void haar_forward_blocks(std::span<const float> in, std::span<float> out, int n);
void haar_forward_blocks(std::span<const double> in, std::span<double> out, int n);
void haar_inverse_blocks(std::span<const float> in, std::span<float> out, int n);
void haar_inverse_blocks(std::span<const double> in, std::span<double> out, int n);

}  // namespace haarlight
