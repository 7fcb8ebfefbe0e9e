// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>

/// @file
/// RayCaster::offset_mm(), in single-precision roundings; docs/numerics/rays.md has where each is from.

namespace haarlight::render {

inline constexpr double kRounding = 0x1p-24;
inline constexpr double kOfDistance = 3.0;  // of the point from Embree's origin
inline constexpr double kOfSide = 8.0;      // of a triangle's longest side
inline constexpr double kOfThinSide = 6.0;  // the same, times how thin the triangle is
inline constexpr double kThinnest = 64.0;   // thinner triangles count as such
inline constexpr double kOfSphere = 24.0;   // of a sphere's radius
inline constexpr double kOfDisk = 16.0;     // of a disk's
inline constexpr double kOfInstance = 4.0;  // of an instance's distance from Embree's origin
inline constexpr double kWithinInstance =
    8.0;  // of the point's distance from the instance's middle

/// What a ray adds that ends near a surface: its direction is rounded and, where Embree seeks the
/// point of the ray that is next to a sphere's centre, differences of its length.
inline constexpr double kOfWay = 8.0;

/// What a triangle adds. Without a branch, for vectors.
/// @param a, b, c       squared lengths of the sides @param area_squared  of the parallelogram
/// @param longest_side  mm, is answered too
inline double triangle_roundings(double a, double b, double c, double area_squared,
                                 double& longest_side) {
  const double shorter = a < b ? a : b;
  const double longer = a < b ? b : a;
  const double longest = longer < c ? c : longer;
  const double middle = longer < c ? longer : c;
  const double thin = std::sqrt(shorter * middle / area_squared);
  longest_side = std::sqrt(longest);
  const double at_most = thin < kThinnest ? thin : kThinnest;  // also where there is no area
  return longest_side * (kOfSide + kOfThinSide * at_most);
}

}  // namespace haarlight::render
