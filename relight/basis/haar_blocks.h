// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "relight/basis/haar.h"

/// @file
/// The Haar transform of haar.h for many arrays at once: the lights of many pixels. Memory is
/// the limit: one read, one non-temporal write, all levels in between in the L1 cache. Same
/// additions in the same order as haar_forward and haar_inverse: bit-identical. Method and
/// figures: docs/numerics/haar.md, "Many arrays".

namespace haarlight {

/// Every array of `in`, one after the other, to the same position in `out`. In parallel.
/// @param in, out  equal sizes, a multiple of the grid's; the same memory or disjoint
/// @throws ContractViolation  no valid grid, other sizes
void haar_forward_blocks(std::span<const float> in, std::span<float> out, const HaarGrid& grid);
void haar_forward_blocks(std::span<const double> in, std::span<double> out,
                         const HaarGrid& grid);
void haar_inverse_blocks(std::span<const float> in, std::span<float> out, const HaarGrid& grid);
void haar_inverse_blocks(std::span<const double> in, std::span<double> out,
                         const HaarGrid& grid);

}  // namespace haarlight
