// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "haarlight/relight/basis/haar.h"

/// @file
/// The Haar transform of haar.h for many arrays at once: the lights of many pixels, all levels
/// in the first cache. Same additions in the same order as haar_forward and haar_inverse: the
/// same bits. Method and figures: docs/numerics/haar.md, "Many arrays".

namespace haarlight::relight {

/// Every array, one after the other, in place. In parallel.
/// @param values  a multiple of the grid's size
/// @throws ContractViolation  no valid grid, part of an array
void haar_forward_blocks(std::span<float> values, const HaarGrid& grid);
void haar_forward_blocks(std::span<double> values, const HaarGrid& grid);
void haar_inverse_blocks(std::span<float> values, const HaarGrid& grid);
void haar_inverse_blocks(std::span<double> values, const HaarGrid& grid);

}  // namespace haarlight::relight
