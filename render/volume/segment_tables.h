// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>

/// @file
/// Polynomials of the two functions behind the closed form of segment_kernel.h; segment_tables.py
/// defines them and writes their coefficients.

namespace haarlight::render {

inline constexpr double kTableScale = 4.0;             ///< c in u = c/(c + x)
inline constexpr std::size_t kTableParts = 64;         ///< equal parts of u in (0, 1]
inline constexpr std::size_t kTableCoefficients = 10;  ///< of t^0 .. t^9, t = -1..1 in a part
inline constexpr std::size_t kTableStride = 2 * kTableCoefficients;

/// By [of erfcx, of Dawson's integral][part][power of t][phi, psi].
using SegmentTables = std::array<double, 2 * kTableParts * kTableStride>;
extern const SegmentTables kSegmentTables;

}  // namespace haarlight::render
