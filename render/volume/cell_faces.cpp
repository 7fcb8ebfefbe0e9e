// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cell_faces.h"

#include <algorithm>
#include <span>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/face_buckets.h"

namespace haarlight::render {

namespace {

using Triangle = std::array<std::uint32_t, 3>;

/// The nodes opposite to node i of a tetrahedron, anticlockwise seen from outside.
constexpr std::array<std::array<std::uint8_t, 3>, 4> kOpposite = {
    {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};

/// A face by its nodes but for the smallest, and which face of which cell it is.
struct Face {
  std::uint32_t middle;
  std::uint32_t largest;
  std::uint32_t cell;
  std::uint32_t number;  ///< within the cell, or of all

  [[nodiscard]] bool is_same(const Face& other) const {
    return middle == other.middle && largest == other.largest;
  }
};

void require_size(const CellMesh& mesh, const std::string& file) {
  constexpr std::size_t kMost = kNoCell / 12;  // twelve triangles of a hexahedron
  if (mesh.n_cells() >= kMost || mesh.points.size() >= kNoCell) {
    throw Error(fmt::format("{} cells and {} points: {} and {} are the most", mesh.n_cells(),
                            mesh.points.size(), kMost, kNoCell),
                file, "render the mesh in parts");
  }
}

/// Finds those that are alike; calls pair(a, b) for two, alone(a) for one.
template <class Pair, class Alone>
void match(FaceBuckets<Face>& buckets, const CellMesh& mesh, const std::string& file,
           const Pair& pair, const Alone& alone) {
  std::size_t begin = 0;
  for (const std::size_t end : buckets.ends) {
    const std::span<Face> alike = std::span(buckets.faces).subspan(begin, end - begin);
    begin = end;
    std::ranges::sort(alike, [](const Face& a, const Face& b) {
      return a.middle != b.middle ? a.middle < b.middle : a.largest < b.largest;
    });
    for (std::size_t i = 0; i < alike.size(); ++i) {
      const Face& face = alike[i];
      if (i + 1 == alike.size() || !face.is_same(alike[i + 1])) {
        alone(face);
        continue;
      }
      const Face& other = alike[++i];
      if (i + 1 < alike.size() && face.is_same(alike[i + 1])) {
        throw Error(fmt::format("cells {}, {} and {} share a face: two of them overlap",
                                mesh.number_in_file(face.cell), mesh.number_in_file(other.cell),
                                mesh.number_in_file(alike[i + 1].cell)),
                    file, "remove one of them");
      }
      pair(face, other);
    }
  }
}

/// Calls visit as faces_by_node() wants.
template <class Visit>
void visit_triangle(Triangle nodes, std::uint32_t cell, std::uint32_t number,
                    const Visit& visit) {
  std::ranges::sort(nodes);
  visit(nodes[0], [&] {
    return Face{.middle = nodes[1], .largest = nodes[2], .cell = cell, .number = number};
  });
}

CellFaces connect_tetrahedra(const CellMesh& mesh, const std::string& file) {
  CellFaces made;
  made.tetrahedra.resize(mesh.n_cells());
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    std::ranges::copy(mesh.nodes_of(i), made.tetrahedra[i].nodes.begin());
    made.tetrahedra[i].neighbours.fill(kNoCell);
  }
  const auto face_of = [&made](std::uint32_t cell, std::uint32_t number) {
    const std::array<std::uint32_t, 4>& nodes = made.tetrahedra[cell].nodes;
    const std::array<std::uint8_t, 3>& face = kOpposite.at(number);
    return Triangle{nodes.at(face[0]), nodes.at(face[1]), nodes.at(face[2])};
  };
  FaceBuckets<Face> faces = faces_by_node<Face>(mesh.points.size(), [&](const auto& visit) {
    for (std::uint32_t cell = 0; cell < made.tetrahedra.size(); ++cell) {
      for (std::uint32_t number = 0; number < 4; ++number) {
        visit_triangle(face_of(cell, number), cell, number, visit);
      }
    }
  });
  match(
      faces, mesh, file,
      [&](const Face& a, const Face& b) {
        made.tetrahedra[a.cell].neighbours.at(a.number) = b.cell;
        made.tetrahedra[b.cell].neighbours.at(b.number) = a.cell;
      },
      [&](const Face& face) {
        made.boundary.push_back({.nodes = face_of(face.cell, face.number), .cell = face.cell});
      });
  return made;
}

/// Turns the corners of a face such that the one of the smallest number is first, for both its
/// cells.
void begin_at_smallest(std::span<const std::uint32_t> nodes,
                       std::array<std::uint8_t, 4>& loop) {
  const auto smallest =
      std::ranges::min_element(loop, {}, [&](std::uint8_t corner) { return nodes[corner]; });
  std::rotate(loop.begin(), smallest, loop.end());
}

/// The triangles of a face, of which corners may be the same.
void add_triangles(std::span<const std::uint32_t> nodes,
                   const std::array<std::uint8_t, 4>& corners, std::vector<CellFace>& faces) {
  std::array<std::uint8_t, 4> loop{};
  std::size_t n = 0;
  for (const std::uint8_t corner : corners) {
    if (corner != kNone && (n == 0 || nodes[corner] != nodes[loop.at(n - 1)])) {
      loop.at(n++) = corner;
    }
  }
  if (n > 1 && nodes[loop.at(n - 1)] == nodes[loop[0]]) {
    --n;
  }
  const auto add = [&](std::uint8_t a, std::uint8_t b, std::uint8_t c) {
    if (nodes[a] != nodes[b] && nodes[b] != nodes[c] && nodes[c] != nodes[a]) {
      faces.push_back({.nodes = {nodes[a], nodes[b], nodes[c]}, .corners = {a, b, c}});
    }
  };
  if (n == 3) {
    add(loop[0], loop[1], loop[2]);
  } else if (n == 4) {
    begin_at_smallest(nodes, loop);
    add(loop[0], loop[1], loop[2]);
    add(loop[0], loop[2], loop[3]);
  }
}

/// Whether two faces of the same corners are one surface.
bool are_one(const CellMesh& mesh, std::uint32_t cell, const CellFace& face,
             std::uint32_t other_cell, const CellFace& other) {
  if (!face.is_bent() && !other.is_bent()) {
    return true;
  }
  if (face.is_bent() != other.is_bent()) {
    return false;
  }
  const PatchNodes a = sorted(nodes_of_bent(mesh, cell, face)).patch;
  const PatchNodes b = sorted(nodes_of_bent(mesh, other_cell, other)).patch;
  if (a.form != b.form) {
    return false;
  }
  for (std::size_t k = 0; k < a.n; ++k) {
    const bool is_corner = k < a.n_corners();
    if (is_corner ? a.nodes.at(k) != b.nodes.at(k)
                  : mesh.points[a.nodes.at(k)] != mesh.points[b.nodes.at(k)]) {
      return false;
    }
  }
  return true;
}

/// A face that is one patch.
void add_bent(std::span<const std::uint32_t> nodes, const std::array<std::uint8_t, 4>& corners,
              std::size_t side, std::vector<CellFace>& faces) {
  std::array<std::uint8_t, 4> loop = corners;
  std::array<std::uint8_t, 3> chosen = {loop[0], loop[1], loop[2]};
  if (loop[3] != kNone) {
    begin_at_smallest(nodes, loop);
    const bool is_second = nodes[loop[1]] < nodes[loop[3]];
    chosen = {loop[0], is_second ? loop[1] : loop[2], is_second ? loop[2] : loop[3]};
  }
  faces.push_back({.nodes = {nodes[chosen[0]], nodes[chosen[1]], nodes[chosen[2]]},
                   .corners = chosen,
                   .bent_side = static_cast<std::uint8_t>(side)});
}

/// All faces of all cells, and which are bent.
void add_faces(const CellMesh& mesh, CellFaces& made) {
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    made.begins.push_back(static_cast<std::uint32_t>(made.faces.size()));
    const CellShape& shape = shape_of(mesh.types[i]);
    const bool is_bent = bend_of(mesh, i) > 0.0;
    if (is_bent) {
      made.is_bent.resize(mesh.n_cells());
      made.is_bent[i] = true;
    }
    for (std::size_t side = 0; side < shape.faces.size(); ++side) {
      if (is_bent && bend_of_face(mesh, i, side) > 0.0) {
        add_bent(mesh.nodes_of(i), shape.faces[side], side, made.faces);
      } else {
        add_triangles(mesh.nodes_of(i), shape.faces[side], made.faces);
      }
    }
  }
  made.begins.push_back(static_cast<std::uint32_t>(made.faces.size()));
}

CellFaces connect_general(const CellMesh& mesh, const std::string& file) {
  CellFaces made;
  made.begins.reserve(mesh.n_cells() + 1);
  add_faces(mesh, made);
  const auto add_boundary = [&made](const Face& face) {
    made.boundary.push_back(
        {.nodes = made.faces[face.number].nodes, .cell = face.cell, .number = face.number});
  };
  FaceBuckets<Face> faces = faces_by_node<Face>(mesh.points.size(), [&](const auto& visit) {
    for (std::uint32_t cell = 0; cell + 1 < made.begins.size(); ++cell) {
      for (std::uint32_t i = made.begins[cell]; i < made.begins[cell + 1]; ++i) {
        visit_triangle(made.faces[i].nodes, cell, i, visit);
      }
    }
  });
  match(
      faces, mesh, file,
      [&](const Face& a, const Face& b) {
        if (are_one(mesh, a.cell, made.faces[a.number], b.cell, made.faces[b.number])) {
          made.faces[a.number].neighbour = b.cell;
          made.faces[b.number].neighbour = a.cell;
        } else {
          add_boundary(a);
          add_boundary(b);
        }
      },
      add_boundary);
  return made;
}

}  // namespace

PatchNodes nodes_of_bent(const CellMesh& mesh, std::uint32_t cell, const CellFace& face) {
  const FaceNodes of_cell = nodes_of_face(mesh.types[cell], face.bent_side);
  PatchNodes patch{.form = of_cell.form, .n = of_cell.n};
  for (std::size_t i = 0; i < of_cell.n; ++i) {
    patch.nodes.at(i) = mesh.nodes_of(cell)[of_cell.nodes.at(i)];
  }
  return patch;
}

SortedPatch sorted(const PatchNodes& patch) {
  const std::size_t n = patch.n_corners();
  const auto& given = patch.nodes;
  const auto first = static_cast<std::size_t>(
      std::min_element(given.begin(), given.begin() + static_cast<std::ptrdiff_t>(n)) -
      given.begin());
  SortedPatch made{.patch = patch};
  made.is_turned = given.at((first + 1) % n) > given.at((first + n - 1) % n);
  const std::size_t n_on_edge = patch.form == PatchForm::cubic_triangle ? 2 : 1;
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t from = made.is_turned ? (first + n - i) % n : (first + i) % n;
    const std::size_t edge = made.is_turned ? (from + n - 1) % n : from;
    made.order.at(i) = static_cast<std::uint8_t>(from);
    made.patch.nodes.at(i) = given.at(from);
    for (std::size_t k = 0; k < n_on_edge; ++k) {
      made.patch.nodes.at(n + n_on_edge * i + k) =
          given.at(n + n_on_edge * edge + (made.is_turned ? n_on_edge - 1 - k : k));
    }
  }
  return made;
}

void require_straight(const CellMesh& mesh, const std::string& file) {
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    if (const double bend = bend_of(mesh, i); bend > 0.0) {
      throw Error(
          fmt::format(
              "cell {} is a {} with a bent edge: a node is {:.3g} off its straight position",
              mesh.number_in_file(i), shape_of(mesh.types[i]).name, bend),
          file, "give --algorithm ray-casting, which renders bent cells");
    }
  }
}

CellFaces connect_cells(const CellMesh& mesh, const std::string& file, FaceForm form) {
  require_size(mesh, file);
  const bool are_tetrahedra = std::ranges::all_of(
      mesh.types, [](CellType type) { return type == CellType::tetrahedron; });
  return are_tetrahedra && form == FaceForm::tetrahedra_where_all_are
             ? connect_tetrahedra(mesh, file)
             : connect_general(mesh, file);
}

}  // namespace haarlight::render
