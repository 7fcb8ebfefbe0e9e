// SPDX-License-Identifier: Apache-2.0
#include "render/volume/tetrahedra.h"

#include <algorithm>
#include <span>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

/// A face by its nodes but for the smallest, and the cell's node opposite to it.
struct Face {
  std::uint32_t middle;
  std::uint32_t largest;
  std::uint32_t cell;
  std::uint8_t node;

  [[nodiscard]] bool is_same(const Face& other) const {
    return middle == other.middle && largest == other.largest;
  }
};

std::array<std::uint32_t, 3> sorted_nodes(const Tetrahedron& cell, std::size_t node) {
  const std::array<std::uint8_t, 3>& face = kTetrahedronFaces.at(node);
  std::array<std::uint32_t, 3> nodes = {cell.nodes.at(face[0]), cell.nodes.at(face[1]),
                                        cell.nodes.at(face[2])};
  std::ranges::sort(nodes);
  return nodes;
}

void require_tetrahedra(const CellMesh& mesh, const std::string& file) {
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    if (mesh.types[i] != CellType::tetrahedron) {
      throw Error(fmt::format("cell {} is a {}; tetrahedra are rendered, nothing else yet",
                              mesh.number_in_file(i), shape_of(mesh.types[i]).name),
                  file, "split the cells into tetrahedra");
    }
  }
  if (mesh.n_cells() >= kNoCell || mesh.points.size() >= kNoCell) {
    throw Error(fmt::format("{} cells and {} points: 2^32 - 2 are the most", mesh.n_cells(),
                            mesh.points.size()),
                file, "render the mesh in parts");
  }
}

/// All faces that have the same smallest node, of which there are few.
void connect(std::span<Face> faces, const CellMesh& mesh, const std::string& file,
             Tetrahedra& made) {
  std::ranges::sort(faces, [](const Face& a, const Face& b) {
    return a.middle != b.middle ? a.middle < b.middle : a.largest < b.largest;
  });
  for (std::size_t i = 0; i < faces.size(); ++i) {
    const Face& face = faces[i];
    if (i + 1 == faces.size() || !face.is_same(faces[i + 1])) {
      made.boundary.push_back({.cell = face.cell, .node = face.node});
      continue;
    }
    const Face& other = faces[++i];
    if (i + 1 < faces.size() && face.is_same(faces[i + 1])) {
      throw Error(fmt::format("cells {}, {} and {} share a face: two of them overlap",
                              mesh.number_in_file(face.cell), mesh.number_in_file(other.cell),
                              mesh.number_in_file(faces[i + 1].cell)),
                  file, "remove one of them");
    }
    made.cells[face.cell].neighbours.at(face.node) = other.cell;
    made.cells[other.cell].neighbours.at(other.node) = face.cell;
  }
}

}  // namespace

Tetrahedra connect_tetrahedra(const CellMesh& mesh, const std::string& file) {
  require_tetrahedra(mesh, file);
  Tetrahedra made;
  made.cells.resize(mesh.n_cells());
  std::vector<std::size_t> ends(mesh.points.size() + 1, 0);  // of each smallest node's faces
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    Tetrahedron& cell = made.cells[i];
    std::ranges::copy(mesh.nodes_of(i), cell.nodes.begin());
    cell.neighbours.fill(kNoCell);
    for (std::size_t node = 0; node < 4; ++node) {
      ++ends[sorted_nodes(cell, node)[0]];
    }
  }
  std::size_t n = 0;
  for (std::size_t& end : ends) {
    n += std::exchange(end, n);
  }
  std::vector<Face> faces(n);
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    for (std::size_t node = 0; node < 4; ++node) {
      const std::array<std::uint32_t, 3> nodes = sorted_nodes(made.cells[i], node);
      faces[ends[nodes[0]]++] = {.middle = nodes[1],
                                 .largest = nodes[2],
                                 .cell = static_cast<std::uint32_t>(i),
                                 .node = static_cast<std::uint8_t>(node)};
    }
  }
  std::size_t begin = 0;
  for (const std::size_t end : ends) {
    connect(std::span(faces).subspan(begin, end - begin), mesh, file, made);
    begin = end;
  }
  return made;
}

}  // namespace haarlight::render
