// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/cell_mesh_check.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/face_buckets.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

/// Of the cube of the longest edge: rounding of coordinates near 0 makes a volume of 1e-16.
constexpr double kFlatVolume = 1e-14;

/// A face by its corners in rising order but for the smallest; a triangle's last is kNoNode.
struct FaceKey {
  std::array<std::uint32_t, 3> nodes{};
  std::uint32_t side = 0;  ///< of its cell
  std::size_t cell = 0;
};
constexpr std::uint32_t kNoNode = std::numeric_limits<std::uint32_t>::max();

class Checker {
 public:
  Checker(const CellMesh& mesh, const std::string& file) : mesh_(mesh), file_(file) {}

  MeshCheck check() {
    if (mesh_.n_cells() == 0) {
      throw Error("the file holds no solid cells", file_,
                  "export the volume's cells: tetrahedra, hexahedra, wedges or pyramids");
    }
    check_points();
    for (std::size_t i = 0; i < mesh_.n_cells(); ++i) {
      check_cell(i);
    }
    if (!std::isfinite(check_.volume)) {
      throw Error("the mesh is too large for the numbers used", file_, "scale the mesh down");
    }
    count_faces();
    count_parts();
    return check_;
  }

 private:
  [[noreturn]] void refuse(std::size_t i_cell, const std::string& what,
                           const std::string& hint) const {
    throw Error(fmt::format("cell {}, a {}, {}", mesh_.number_in_file(i_cell),
                            shape_of(mesh_.types[i_cell]).name, what),
                file_, hint);
  }

  void check_points() {
    check_.low = check_.high = mesh_.points.empty() ? Vector3d::Zero() : mesh_.points[0];
    for (std::size_t i = 0; i < mesh_.points.size(); ++i) {
      const Vector3d& point = mesh_.points[i];
      if (!point.allFinite()) {
        throw Error(fmt::format("point {} is not finite", i), file_,
                    "repair the mesh before export");
      }
      check_.low = check_.low.cwiseMin(point);
      check_.high = check_.high.cwiseMax(point);
    }
  }

  void check_cell(std::size_t i_cell) {
    const CellType type = mesh_.types[i_cell];
    const CellShape& shape = shape_of(type);
    const std::span<const std::uint32_t> nodes = mesh_.nodes_of(i_cell);
    for (const std::uint32_t node : nodes) {
      if (node >= mesh_.points.size()) {
        refuse(i_cell, fmt::format("names point {} of {}", node, mesh_.points.size()),
               "points count from 0 to their number minus 1: export the mesh again");
      }
    }
    ++check_.n_of_type.at(static_cast<std::size_t>(type));
    double size = 0.0;
    std::optional<std::uint32_t> repeated;
    for (std::size_t i = 0; i < shape.n_corners; ++i) {
      for (std::size_t k = i + 1; k < shape.n_corners; ++k) {
        size = std::max(size, (at(nodes[i]) - at(nodes[k])).norm());
        repeated = nodes[i] == nodes[k] ? nodes[i] : repeated;
      }
    }
    const double tolerance = kFlatVolume * size * size * size;
    const double volume = cell_volume(mesh_, i_cell);
    if (!std::isfinite(volume) || !std::isfinite(tolerance)) {
      refuse(i_cell, "is too large for the numbers used", "scale the mesh down");
    }
    if (volume < -tolerance) {
      refuse(i_cell, fmt::format("is inverted: its volume is {:.3g}", volume),
             "its nodes stand in another order than this format's: export the mesh again");
    }
    if (!(volume > tolerance)) {
      refuse(i_cell,
             repeated ? fmt::format("names point {} twice and is flat", *repeated)
                      : fmt::format("is flat: its volume is {:.3g}", volume),
             "leave out cells without volume, or mesh that region again");
    }
    for (const auto& corner : shape.corners) {
      const Vector3d& tip = at(nodes[corner[0]]);
      const double six_volumes =
          (at(nodes[corner[1]]) - tip)
              .dot((at(nodes[corner[2]]) - tip).cross(at(nodes[corner[3]]) - tip));
      if (six_volumes < -tolerance) {
        refuse(i_cell, fmt::format("is inverted at its node {}", corner[0]),
               "mesh that region again, with better cells");
      }
    }
    check_.n_collapsed_cells += repeated ? 1 : 0;
    check_.smallest_volume = i_cell == 0 ? volume : std::min(check_.smallest_volume, volume);
    check_.largest_volume = std::max(check_.largest_volume, volume);
    check_.volume += volume;
    if (shape.may_bend()) {
      const double bend = bend_of(mesh_, i_cell);
      check_.n_curved_cells += bend > 0.0 ? 1 : 0;
      check_.largest_bend = std::max(check_.largest_bend, bend);
      check_folding(i_cell, bend);
    }
  }

  /// Of a bent cell: it must not be turned inside out anywhere.
  void check_folding(std::size_t i_cell, double bend) const {
    if (!(bend > 0.0)) {
      return;
    }
    const Folding folding = folding_of(mesh_, i_cell);
    if (folding != Folding::none) {
      refuse(i_cell,
             folding == Folding::folded
                 ? "is folded: its bent edges turn a part of it inside out"
                 : "is folded, or too nearly so to tell: somewhere its bent edges leave it no "
                   "volume",
             shape_of(mesh_.types[i_cell]).on_edge == 1
                 ? "move its middle nodes nearer to the middles of their edges, or mesh that "
                   "region more finely"
                 : "move the nodes on its edges nearer to their thirds, or mesh that region "
                   "more finely");
    }
  }

  /// Calls visit(smallest corner, make) for each side of a cell that is not an edge or a point.
  template <class Visit>
  void for_each_side(const Visit& visit) const {
    for (std::size_t i = 0; i < mesh_.n_cells(); ++i) {
      const std::span<const std::uint32_t> nodes = mesh_.nodes_of(i);
      const auto& faces = shape_of(mesh_.types[i]).faces;
      for (std::size_t side = 0; side < faces.size(); ++side) {
        std::array<std::uint32_t, 4> corners{};
        for (std::size_t c = 0; c < 4; ++c) {
          const std::uint8_t corner = faces[side].at(c);
          corners.at(c) = corner == kNone ? kNoNode : nodes[corner];
        }
        std::sort(corners.begin(), corners.end());
        auto* const end = std::unique(corners.begin(), corners.end());
        std::fill(end, corners.end(), kNoNode);
        if (corners[2] != kNoNode) {
          visit(corners[0], [&] {
            return FaceKey{.nodes = {corners[1], corners[2], corners[3]},
                           .side = static_cast<std::uint32_t>(side),
                           .cell = i};
          });
        }
      }
    }
  }

  void count_faces() {
    FaceBuckets<FaceKey> keys = faces_by_node<FaceKey>(
        mesh_.points.size(), [this](const auto& visit) { for_each_side(visit); });
    auto first = keys.faces.begin();
    for (const std::size_t bucket_end : keys.ends) {
      const auto end = keys.faces.begin() + static_cast<std::ptrdiff_t>(bucket_end);
      std::sort(first, end,
                [](const FaceKey& a, const FaceKey& b) { return a.nodes < b.nodes; });
      while (first != end) {
        const auto last = std::find_if(
            first, end, [&](const FaceKey& key) { return key.nodes != first->nodes; });
        ++check_.n_faces;
        check_.n_boundary_faces += last - first == 1 ? 1 : 0;
        check_.n_crowded_faces += last - first > 2 ? 1 : 0;
        if (first->nodes[2] != kNoNode) {
          measure_deviation(*first);
        }
        first = last;
      }
    }
  }

  void measure_deviation(const FaceKey& key) {
    const CellShape& shape = shape_of(mesh_.types[key.cell]);
    if (shape.may_bend()) {
      return;  // bend_of() tells
    }
    const auto& face = shape.faces[key.side];
    const std::span<const std::uint32_t> nodes = mesh_.nodes_of(key.cell);
    std::array<Vector3d, 4> x;
    for (std::size_t c = 0; c < 4; ++c) {
      x.at(c) = at(nodes[face.at(c)]);
    }
    const double deviation = deviation_of(x);
    check_.n_non_planar_faces += deviation > 0.0 ? 1 : 0;
    check_.largest_deviation = std::max(check_.largest_deviation, deviation);
  }

  std::uint32_t root_of(std::uint32_t point) {
    while (parents_[point] != point) {
      parents_[point] = parents_[parents_[point]];
      point = parents_[point];
    }
    return point;
  }

  void count_parts() {
    parents_.resize(mesh_.points.size());
    std::iota(parents_.begin(), parents_.end(), 0U);
    std::vector<bool> is_used(mesh_.points.size());
    for (std::size_t i = 0; i < mesh_.n_cells(); ++i) {
      const std::span<const std::uint32_t> nodes = mesh_.nodes_of(i);
      for (const std::uint32_t node : nodes) {
        is_used[node] = true;
        parents_[root_of(node)] = root_of(nodes[0]);
      }
    }
    for (std::uint32_t i = 0; i < parents_.size(); ++i) {
      check_.n_unused_points += is_used[i] ? 0 : 1;
      check_.n_parts += is_used[i] && parents_[i] == i ? 1 : 0;
    }
  }

  [[nodiscard]] const Vector3d& at(std::uint32_t node) const { return mesh_.points[node]; }

  const CellMesh& mesh_;
  const std::string& file_;
  MeshCheck check_;
  std::vector<std::uint32_t> parents_;
};

}  // namespace

MeshCheck check_cell_mesh(const CellMesh& mesh, const std::string& file) {
  return Checker(mesh, file).check();
}

}  // namespace haarlight::render
