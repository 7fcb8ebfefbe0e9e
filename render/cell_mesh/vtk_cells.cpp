// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/vtk_cells.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

constexpr int kVoxel = 11;
constexpr int kLagrangeTetrahedron = 71;

/// @param n_nodes  tells the degree of a Lagrange cell
std::optional<CellType> type_of(int vtk, std::size_t n_nodes) {
  switch (vtk) {
    case 10:
      return CellType::tetrahedron;
    case kVoxel:
    case 12:
      return CellType::hexahedron;
    case 13:
      return CellType::wedge;
    case 14:
      return CellType::pyramid;
    case 24:
      return CellType::quadratic_tetrahedron;
    case 25:
      return CellType::quadratic_hexahedron;
    case 26:
      return CellType::quadratic_wedge;
    case 27:
      return CellType::quadratic_pyramid;
    case 29:
      return CellType::triquadratic_hexahedron;
    case kLagrangeTetrahedron:  // of degree 1 to 3 their nodes are in the same order as others'
      for (const CellType type : {CellType::tetrahedron, CellType::quadratic_tetrahedron,
                                  CellType::cubic_tetrahedron}) {
        if (shape_of(type).n_nodes == n_nodes) {
          return type;
        }
      }
      return std::nullopt;
    default:
      return std::nullopt;
  }
}

/// Points, lines and surfaces: no volume to render.
bool is_flat(int vtk) {
  constexpr std::array<std::pair<int, int>, 7> kRanges = {
      {{0, 9}, {21, 23}, {28, 28}, {30, 30}, {34, 36}, {51, 52}, {68, 70}}};
  return std::any_of(kRanges.begin(), kRanges.end(), [vtk](const auto& range) {
    return vtk >= range.first && vtk <= range.second;
  });
}

std::string_view solid_name(int vtk) {
  switch (vtk) {
    case 15:
      return "pentagonal prism";
    case 16:
      return "hexagonal prism";
    case 32:
      return "quadratic wedge of 18 nodes";
    case 33:
      return "hexahedron of 24 nodes";
    case 42:
      return "polyhedron";
    case kLagrangeTetrahedron:
      return "Lagrange tetrahedron of degree 4 or more";
    case 72:
      return "Lagrange hexahedron";
    default:
      return "cell of another kind";
  }
}

class Appender {
 public:
  Appender(VtkPiece piece, const std::string& where, CellMesh& mesh)
      : piece_(std::move(piece)),
        where_(where),
        mesh_(mesh),
        first_point_(mesh.points.size()),
        first_in_file_(mesh.n_cells() + mesh.n_left_out) {}

  void append() {
    const bool is_first = first_point_ == 0 && first_in_file_ == 0;
    add_points();
    std::size_t begin = 0;
    for (std::size_t i = 0; i < piece_.types.size(); ++i) {
      const double end = piece_.ends[i];
      if (!(end >= static_cast<double>(begin) &&
            end <= static_cast<double>(piece_.nodes.size())) ||
          end != std::floor(end)) {
        refuse(i, fmt::format("ends at node {} of {}, after one that ends at {}", end,
                              piece_.nodes.size(), begin));
      }
      add_cell(i, begin, static_cast<std::size_t>(end));
      begin = static_cast<std::size_t>(end);
    }
    if (begin != piece_.nodes.size()) {
      throw Error(fmt::format("{} nodes belong to no cell", piece_.nodes.size() - begin),
                  where_, "the file is damaged: export the mesh again");
    }
    merge(std::move(piece_.point_fields), is_first, mesh_.point_fields);
    keep_solid_values();
    merge(std::move(piece_.cell_fields), is_first, mesh_.cell_fields);
  }

 private:
  [[noreturn]] void refuse(
      std::size_t i, const std::string& what,
      const std::string& hint = "the file is damaged: export the mesh again") const {
    throw Error(fmt::format("cell {} {}", first_in_file_ + i, what), where_, hint);
  }

  void add_points() {
    const std::size_t n = piece_.points.size() / 3;
    if (first_point_ + n >= std::numeric_limits<std::uint32_t>::max()) {
      throw Error("more than 4 thousand million points", where_, "give the mesh in parts");
    }
    mesh_.points.reserve(first_point_ + n);
    for (std::size_t i = 0; i < n; ++i) {
      mesh_.points.emplace_back(piece_.points[3 * i], piece_.points[3 * i + 1],
                                piece_.points[3 * i + 2]);
    }
    piece_.points = {};
  }

  void add_cell(std::size_t i, std::size_t begin, std::size_t end) {
    const double number = piece_.types[i];
    if (!(number >= 0.0 && number <= 255.0) || number != std::floor(number)) {
      refuse(i, fmt::format("is of type {}", number));
    }
    const int vtk = static_cast<int>(number);
    const std::optional<CellType> type = type_of(vtk, end - begin);
    if (!type && is_flat(vtk)) {
      ++mesh_.n_left_out;
      return;
    }
    if (!type) {
      refuse(i, fmt::format("is a {} (VTK's type {}), which is not read", solid_name(vtk), vtk),
             "export tetrahedra, hexahedra, wedges or pyramids, linear or quadratic");
    }
    const CellShape& shape = shape_of(*type);
    if (end - begin != shape.n_nodes) {
      refuse(i, fmt::format("is a {} of {} nodes instead of {}", shape.name, end - begin,
                            shape.n_nodes));
    }
    mesh_.types.push_back(*type);
    mesh_.begins.push_back(mesh_.nodes.size());
    mesh_.numbers_in_file.push_back(first_in_file_ + i);
    solid_.push_back(i);
    for (std::size_t k = 0; k < shape.n_nodes; ++k) {
      constexpr std::array<std::size_t, 8> kOfVoxel = {0, 1, 3, 2, 4, 5, 7, 6};
      mesh_.nodes.push_back(point_of(i, begin + (vtk == kVoxel ? kOfVoxel.at(k) : k)));
    }
    if (shape.linear == CellType::wedge) {
      set_upright();
    }
  }

  /// The last cell, a wedge. As it stands it is inverted if it is in VTK's order, where 3 4 5 are below.
  void set_upright() {
    auto* const nodes = mesh_.nodes.data() + mesh_.begins.back();
    if (cell_volume(mesh_, mesh_.n_cells() - 1) > 0.0) {
      ++mesh_.n_other_wedges;
      return;
    }
    std::swap_ranges(nodes, nodes + 3, nodes + 3);
    if (mesh_.types.back() == CellType::quadratic_wedge) {
      std::swap_ranges(nodes + 6, nodes + 9, nodes + 9);
    }
  }

  [[nodiscard]] std::uint32_t point_of(std::size_t i, std::size_t at) const {
    const double node = piece_.nodes[at];
    const std::size_t n = mesh_.points.size() - first_point_;
    if (!(node >= 0.0 && node < static_cast<double>(n)) || node != std::floor(node)) {
      refuse(i, fmt::format("names point {} of {}", node, n),
             "points count from 0 to their number minus 1: export the mesh again");
    }
    return static_cast<std::uint32_t>(first_point_ + static_cast<std::size_t>(node));
  }

  void keep_solid_values() {
    if (solid_.size() == piece_.types.size()) {
      return;
    }
    for (MeshField& field : piece_.cell_fields) {
      const std::size_t n = field.n_components;
      for (std::size_t k = 0; k < solid_.size(); ++k) {
        for (std::size_t c = 0; c < n; ++c) {
          field.values[k * n + c] = field.values[solid_[k] * n + c];
        }
      }
      field.values.resize(solid_.size() * n);
    }
  }

  void merge(std::vector<MeshField> fields, bool is_first, std::vector<MeshField>& all) const {
    if (is_first) {
      all = std::move(fields);
      return;
    }
    if (fields.size() != all.size()) {
      throw Error(
          fmt::format("a piece has {} fields, the first one {}", fields.size(), all.size()),
          where_, "export every piece with the same fields");
    }
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (fields[i].name != all[i].name || fields[i].n_components != all[i].n_components) {
        throw Error(fmt::format("a piece has '{}' of {} components, where the first one has "
                                "'{}' of {}",
                                fields[i].name, fields[i].n_components, all[i].name,
                                all[i].n_components),
                    where_, "export every piece with the same fields in the same order");
      }
      all[i].values.insert(all[i].values.end(), fields[i].values.begin(),
                           fields[i].values.end());
    }
  }

  VtkPiece piece_;
  const std::string& where_;
  CellMesh& mesh_;
  std::size_t first_point_;
  std::size_t first_in_file_;
  std::vector<std::size_t> solid_;  ///< the piece's cells that were taken
};

}  // namespace

void append_piece(VtkPiece piece, const std::string& where, CellMesh& mesh) {
  Appender(std::move(piece), where, mesh).append();
}

}  // namespace haarlight::render
