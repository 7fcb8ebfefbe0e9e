// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// Polygons on the sphere of directions: corners joined by great circles, clipped by planes
/// through the centre, measured exactly. Corners need not have length 1. Pure.

namespace haarlight::render {

/// Corners in counter-clockwise order seen from outside the sphere.
using DirectionPolygon = std::vector<Eigen::Vector3d>;

/// Signed solid angle of a triangle, steradian; positive when counter-clockwise from outside.
/// [VanOosterom83], eq. (8), the determinant taken from differences so that tiny triangles keep
/// their precision: relative error <= 1e-13 down to 1e-12 sr.
[[nodiscard]] double triangle_solid_angle(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                          const Eigen::Vector3d& c);

/// Signed solid angle of a polygon smaller than a hemisphere (a fan of triangles).
[[nodiscard]] double solid_angle(std::span<const Eigen::Vector3d> polygon);

/// Keeps the part with normal . d >= 0 [Sutherland74]. The result may be empty.
/// @param out  overwritten; must not be `polygon`
void clip_polygon(const DirectionPolygon& polygon, const Eigen::Vector3d& normal,
                  DirectionPolygon& out);

}  // namespace haarlight::render
