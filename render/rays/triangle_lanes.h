// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "render/rays/lanes.h"

/// @file
/// Where rays meet the triangles that Embree has named, in double precision, for many at once.

namespace haarlight::render {

struct TriangleLanes {
  // Given:
  VectorLanes first;  ///< corners, world, mm
  VectorLanes second;
  VectorLanes third;
  Lanes
      side;  ///< -1 where the corners go clockwise about the front, as a mirrored instance's do; else 1
  VectorLanes origin;
  VectorLanes direction;  ///< unit
  Lanes t;                ///< Embree's: along the ray, and barycentric
  Lanes u;
  Lanes v;
  // Found:
  VectorLanes flat;  ///< unit normal, turned towards the ray's origin
  VectorLanes
      point;  ///< the ray's on the triangle's plane; of a ray that grazes it the triangle's
  Lanes distance;
  Lanes offset;        ///< RayCaster::offset_mm() of a mesh
  Lanes of_triangle;   ///< triangle_roundings()
  Lanes longest_side;  ///< mm
  Lanes slope;  ///< of the front's normal along the ray: not above 0 where the front is met

  /// Of the first `n` lanes. @param slack_mm  by which Embree's t may be off, beside a
  /// ten-thousandth of it @param middle  Embree's origin, world
  void find(std::size_t n, double slack_mm, const Eigen::Vector3d& middle);
};

}  // namespace haarlight::render
