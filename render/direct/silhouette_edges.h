// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"

/// @file
/// The edges where a scene's outline may lie as seen from a point: those between a triangle that
/// faces the point and one that does not, and those with a triangle on one side only. Along any
/// path of directions that crosses none of them, rays from the point meet something or meet
/// nothing all along.

namespace haarlight::render {

/// What is seen from a point through a flat rectangular window.
struct Pyramid {
  Eigen::Vector3d apex;
  std::array<Eigen::Vector3d, 4> sides;  ///< inward normals
  Eigen::Vector3d towards;               ///< unit, square on to the window's plane
  double height = 0.0;                   ///< from the apex to that plane, > 0
  // A cone around it, by which it is searched.
  Eigen::Vector3d axis;  ///< unit
  double cosine = 0.0;   ///< of the angle between the axis and the farthest corner
  double sine = 1.0;
};

/// A part of the outline that may be in one of several pyramids.
struct OutlineEdge {
  int pyramid = 0;
  Eigen::Vector3d a;
  Eigen::Vector3d b;
};

/// Vertices at the same position are one vertex, in whatever mesh. Edges of one triangle, of
/// three or more, or between triangles that are wound in opposite ways always count as outline.
/// Memory: about 150 bytes a triangle. Thread-safe after construction.
class SilhouetteEdges {
 public:
  explicit SilhouetteEdges(std::span<const Mesh> meshes);

  /// Working memory of one thread.
  struct Scratch {
    struct Visit {
      int node;
      int begin;  ///< of the pyramids that the node's parent may meet, in `meets`
      int end;
    };
    std::vector<Visit> visits;
    std::vector<int> meets;
    std::vector<OutlineEdge> found;
  };

  /// The outline as seen from `eye` in pyramids with that apex: into scratch.found, all that
  /// meets one and some that does not.
  void find(const Eigen::Vector3d& eye, std::span<const Pyramid> pyramids,
            Scratch& scratch) const;

  /// Corners of the triangles that have points on both sides of the slab between two planes or
  /// within it: normal.p in [low, high]; some of them twice. Three corners for each triangle.
  [[nodiscard]] std::vector<Eigen::Vector3d> triangles_at(const Eigen::Vector3d& normal,
                                                          double low, double high) const;

 private:
  struct Edge {
    int a;
    int b;
    int left;   ///< triangle
    int right;  ///< triangle, or -1: always outline
  };
  struct Node {
    Eigen::Vector3d centre;
    Eigen::Vector3d half_size;
    double radius = 0.0;
    // All normals of the edges' triangles lie within a cone; cosine -1: not known.
    Eigen::Vector3d axis;
    double cosine = -1.0;
    double sine = 0.0;
    int first = 0;  ///< edge of a leaf, else the first of two children
    int count = 0;  ///< edges of a leaf, 0 else
  };

  void add_edges();
  void cut_long_edges();
  void build();
  void fit(Node& node, int first, int count) const;
  [[nodiscard]] bool faces(int triangle, const Eigen::Vector3d& eye) const;
  [[nodiscard]] bool is_outline(const Edge& edge, const Eigen::Vector3d& eye) const;

  std::vector<Eigen::Vector3d> vertices_;  ///< and points where long edges are cut
  std::vector<Eigen::Vector3i> triangles_;
  std::vector<Eigen::Vector4d> planes_;  ///< unit normal and offset, by triangle
  std::vector<Edge> edges_;
  std::vector<Node> nodes_;
};

}  // namespace haarlight::render
