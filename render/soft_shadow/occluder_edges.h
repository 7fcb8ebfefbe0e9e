// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"
#include "render/soft_shadow/face_tree.h"

/// @file
/// All edges of a scene's triangles with the triangles on their sides, for soft shadows. Vertices at
/// the same position are one vertex, in whatever mesh. Meshes may be open, and any number of
/// triangles may meet in an edge.

namespace haarlight::render {

/// An edge from `from` to `to` and one or two of its triangles; where more meet, they are on
/// further records of the same edge.
struct OccluderEdge {
  static constexpr std::uint32_t kNone = 0xffffffffU;

  std::uint32_t from = 0;
  std::uint32_t to = 0;
  std::array<std::uint32_t, 2> faces = {kNone, kNone};
  /// 1: the triangle's corners go from `from` to `to`; -1: the other way; 0: no such triangle.
  std::array<std::int8_t, 2> ways = {0, 0};
};

/// A triangle, and where it is from.
struct OccluderFace {
  std::array<std::uint32_t, 3> corners;
  std::uint32_t mesh = 0;
  std::uint32_t triangle = 0;  ///< of the mesh
};

/// Memory: about 290 bytes a triangle.
struct OccluderEdges {
  std::vector<Eigen::Vector3d> vertices;  ///< world, mm
  std::vector<OccluderFace> faces;
  std::vector<OccluderEdge> edges;
  FaceTree tree;  ///< of the faces
  /// What each face adds to RayCaster::offset_mm(), over a rounding of single precision.
  std::vector<float> roundings_mm;
};

/// @param meshes  all that cast shadows, instances expanded; triangles without area are left out
[[nodiscard]] OccluderEdges occluder_edges(std::span<const Mesh> meshes);

}  // namespace haarlight::render
