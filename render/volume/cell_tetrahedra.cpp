// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_tetrahedra.h"

#include <algorithm>
#include <cstddef>
#include <span>

namespace haarlight::render {

namespace {

/// Of the nodes 4 to 9 in the middles of edges 01, 12, 20, 03, 13, 23: four corners, and the
/// octahedron that is left, about the line 4-9.
constexpr std::array<std::array<std::uint8_t, 4>, 8> kOfQuadratic = {{{0, 4, 6, 7},
                                                                      {4, 1, 5, 8},
                                                                      {6, 5, 2, 9},
                                                                      {7, 8, 9, 3},
                                                                      {4, 9, 5, 6},
                                                                      {4, 9, 6, 7},
                                                                      {4, 9, 7, 8},
                                                                      {4, 9, 8, 5}}};

void add_from_smallest(const CellMesh& mesh, std::uint32_t cell,
                       std::vector<CellTetrahedron>& tetrahedra) {
  const CellShape& shape = shape_of(mesh.types[cell]);
  const std::span<const std::uint32_t> nodes = mesh.nodes_of(cell);
  const std::uint32_t apex = std::ranges::min(nodes.first(shape.n_corners));
  for (const std::array<std::uint8_t, 4>& face : shape.faces) {
    std::array<std::uint32_t, 4> loop{};
    const std::size_t n = face[3] == kNone ? 3 : 4;
    for (std::size_t i = 0; i < n; ++i) {
      loop.at(i) = nodes[face.at(i)];
    }
    const std::span<std::uint32_t> corners = std::span(loop).first(n);
    if (std::ranges::find(corners, apex) != corners.end()) {
      continue;
    }
    std::rotate(corners.begin(), std::ranges::min_element(corners), corners.end());
    for (std::size_t i = 2; i < n; ++i) {
      // A repeated node leaves none.
      if (corners[i - 1] != corners[i] && corners[i] != corners[0]) {
        tetrahedra.push_back(
            {.nodes = {corners[0], corners[i - 1], corners[i], apex}, .cell = cell});
      }
    }
  }
}

}  // namespace

std::vector<CellTetrahedron> cut_into_tetrahedra(const CellMesh& mesh) {
  std::vector<CellTetrahedron> tetrahedra;
  tetrahedra.reserve(mesh.n_cells());
  for (std::uint32_t cell = 0; cell < mesh.n_cells(); ++cell) {
    const std::span<const std::uint32_t> nodes = mesh.nodes_of(cell);
    if (mesh.types[cell] == CellType::tetrahedron) {
      tetrahedra.push_back({.nodes = {nodes[0], nodes[1], nodes[2], nodes[3]}, .cell = cell});
    } else if (mesh.types[cell] == CellType::quadratic_tetrahedron) {
      for (const std::array<std::uint8_t, 4>& part : kOfQuadratic) {
        tetrahedra.push_back(
            {.nodes = {nodes[part[0]], nodes[part[1]], nodes[part[2]], nodes[part[3]]},
             .cell = cell});
      }
    } else {
      add_from_smallest(mesh, cell, tetrahedra);
    }
  }
  return tetrahedra;
}

}  // namespace haarlight::render
