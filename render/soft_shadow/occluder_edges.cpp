// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/occluder_edges.h"

#include <algorithm>
#include <tuple>

#include <Eigen/Geometry>

#include "render/rays/ray_offset.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

/// Number of each corner's vertex; vertices at one position have one number.
std::vector<std::uint32_t> weld(const std::vector<Vector3d>& corners,
                                std::vector<Vector3d>& vertices) {
  std::vector<std::uint32_t> order(corners.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) {
    order[i] = i;
  }
  const auto position = [&corners](std::uint32_t i) {
    const Vector3d& p = corners[i];
    return std::tuple(p.x(), p.y(), p.z());
  };
  std::ranges::sort(order, {}, position);
  std::vector<std::uint32_t> vertex_of(corners.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (i == 0 || position(order[i]) != position(order[i - 1])) {
      vertices.push_back(corners[order[i]]);
    }
    vertex_of[order[i]] = static_cast<std::uint32_t>(vertices.size() - 1);
  }
  return vertex_of;
}

struct Side {
  std::uint32_t from;
  std::uint32_t to;
  std::uint32_t face;
  std::int8_t way;
};

}  // namespace

OccluderEdges occluder_edges(std::span<const Mesh> meshes) {
  OccluderEdges all;
  std::vector<Vector3d> corners;
  struct Source {
    std::uint32_t mesh;
    std::uint32_t triangle;
  };
  std::vector<Source> sources;
  for (std::uint32_t m = 0; m < meshes.size(); ++m) {
    for (std::uint32_t t = 0; t < meshes[m].triangles.size(); ++t) {
      for (const int corner : meshes[m].triangles[t]) {
        corners.push_back(meshes[m].vertices[static_cast<std::size_t>(corner)]);
      }
      sources.push_back({.mesh = m, .triangle = t});
    }
  }
  const std::vector<std::uint32_t> vertex_of = weld(corners, all.vertices);
  std::vector<Side> sides;
  sides.reserve(corners.size());
  for (std::size_t t = 0; t < sources.size(); ++t) {
    const Vector3d& a = corners[3 * t];
    const Vector3d& b = corners[3 * t + 1];
    const Vector3d& c = corners[3 * t + 2];
    const double area_squared = (b - a).cross(c - a).squaredNorm();
    if (!(area_squared > 0.0)) {
      continue;
    }
    double longest_side = 0.0;
    all.roundings_mm.push_back(static_cast<float>(
        triangle_roundings((b - a).squaredNorm(), (c - b).squaredNorm(), (a - c).squaredNorm(),
                           area_squared, longest_side)));
    const auto face = static_cast<std::uint32_t>(all.faces.size());
    const std::array<std::uint32_t, 3> own = {vertex_of[3 * t], vertex_of[3 * t + 1],
                                              vertex_of[3 * t + 2]};
    all.faces.push_back(
        {.corners = own, .mesh = sources[t].mesh, .triangle = sources[t].triangle});
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t from = own.at(k);
      const std::uint32_t to = own.at((k + 1) % 3);
      sides.push_back({.from = std::min(from, to),
                       .to = std::max(from, to),
                       .face = face,
                       .way = static_cast<std::int8_t>(from < to ? 1 : -1)});
    }
  }
  std::vector<std::array<std::uint32_t, 3>> of_faces;
  of_faces.reserve(all.faces.size());
  for (const OccluderFace& face : all.faces) {
    of_faces.push_back(face.corners);
  }
  all.tree = FaceTree(all.vertices, of_faces);
  std::ranges::sort(sides, {},
                    [](const Side& side) { return std::tuple(side.from, side.to, side.face); });
  for (std::size_t i = 0; i < sides.size();) {
    const Side& side = sides[i];
    OccluderEdge edge{.from = side.from,
                      .to = side.to,
                      .faces = {side.face, OccluderEdge::kNone},
                      .ways = {side.way, 0}};
    ++i;
    if (i < sides.size() && sides[i].from == edge.from && sides[i].to == edge.to) {
      edge.faces[1] = sides[i].face;
      edge.ways[1] = sides[i].way;
      ++i;
    }
    all.edges.push_back(edge);
  }
  return all;
}

}  // namespace haarlight::render
