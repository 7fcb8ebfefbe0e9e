// SPDX-License-Identifier: Apache-2.0
#include "render/volume/visibility_order.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>

#include <fmt/format.h>

#include "core/cpu_time.h"
#include "haarlight/core/error.h"
#include "render/volume/boundary_relations.h"
#include "render/volume/orientation.h"
#include "render/volume/strong_components.h"

namespace haarlight::render {

namespace {

/// Of a face's size: planes of its two triangles that are no farther apart are one.
constexpr double kFlat = 1e-11;

/// For each cell those that a ray may meet next after it.
struct Graph {
  std::vector<std::uint32_t> begins;
  std::vector<std::uint32_t> targets;

  [[nodiscard]] std::span<const std::uint32_t> successors_of(std::uint32_t node) const {
    return std::span(targets).subspan(begins[node], begins[node + 1] - begins[node]);
  }
};

class OrderSearch {
 public:
  explicit OrderSearch(const VolumeView& view)
      : view_(view), orientation_(view), n_cells_(view.scene.mesh.n_cells()) {}

  [[nodiscard]] VisibilityOrder run() {
    const double begin = thread_cpu_seconds();
    find_shown();
    find_exits();
    connect();
    for_each_component(
        n_cells_, [this](std::uint32_t cell) { return graph_.successors_of(cell); },
        [this](std::span<const std::uint32_t> cells) { add_component(cells); });
    std::ranges::sort(order_.cyclic, {},
                      [](const CyclicCells& cyclic) { return cyclic.cells.front(); });
    order_.n_exact = orientation_.n_exact();
    order_.cpu_seconds = thread_cpu_seconds() - begin;
    return std::move(order_);
  }

 private:
  /// Others are on no ray of the picture, and take no part in the order.
  void find_shown() {
    is_shown_.resize(n_cells_);
    const CameraModel& camera = view_.scene.camera;
    for (std::uint32_t cell = 0; cell < n_cells_; ++cell) {
      const std::span<const std::uint32_t> nodes = corners_of(cell);
      double near = std::numeric_limits<double>::infinity();
      double far = -near;
      for (const std::uint32_t node : nodes) {
        near = std::min(near, view_.points[node].seen.z);
        far = std::max(far, view_.points[node].seen.z);
      }
      if (far > view_.near && near < view_.far) {
        const VolumeView::SeenBox box = view_.box_of(nodes);
        is_shown_[cell] = box.high.x() >= -0.5 && box.low.x() <= camera.width - 0.5 &&
                                  box.high.y() >= -0.5 && box.low.y() <= camera.height - 0.5
                              ? 1
                              : 0;
      }
      order_.n_outside += is_shown_[cell] != 0 ? 0 : 1;
    }
  }

  [[nodiscard]] std::span<const std::uint32_t> corners_of(std::uint32_t cell) const {
    const CellMesh& mesh = view_.scene.mesh;
    return mesh.nodes_of(cell).first(shape_of(mesh.types[cell]).n_corners);
  }

  /// By which faces rays leave their cells.
  void find_exits() {
    const std::vector<CellFace>& faces = view_.mesh.faces;
    is_exit_.resize(faces.size());
    for (std::uint32_t cell = 0; cell < n_cells_; ++cell) {
      if (is_shown_[cell] == 0) {
        continue;
      }
      for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
        const std::array<std::uint32_t, 3>& a = faces[i].nodes;
        const int sign = orientation_.sign(a[0], a[1], a[2]);
        is_exit_[i] = sign > 0 ? 1 : 0;
        // The two triangles of a flat face of four corners may be seen from two sides by rounding.
        if (i > view_.mesh.begins[cell]) {
          const std::array<std::uint32_t, 3>& b = faces[i - 1].nodes;
          if (a[0] == b[0] && a[1] == b[2] && faces[i].neighbour == faces[i - 1].neighbour &&
              is_exit_[i] != is_exit_[i - 1] && is_flat(b, a[2])) {
            is_exit_[i] = is_exit_[i - 1] = signed_area(a) + signed_area(b) > 0.0 ? 1 : 0;
          }
        }
      }
    }
  }

  /// det of the face's corners: to the last bit the opposite for the cell beyond it.
  [[nodiscard]] double signed_area(const std::array<std::uint32_t, 3>& nodes) const {
    std::array<std::uint32_t, 3> sorted = nodes;
    std::ranges::sort(sorted);
    const bool is_even = (sorted[0] == nodes[0] && sorted[1] == nodes[1]) ||
                         (sorted[0] == nodes[1] && sorted[1] == nodes[2]) ||
                         (sorted[0] == nodes[2] && sorted[1] == nodes[0]);
    const double det = orientation_.value(sorted[0], sorted[1], sorted[2]);
    return is_even ? det : -det;
  }

  /// Whether the fourth corner is in the triangle's plane.
  [[nodiscard]] bool is_flat(const std::array<std::uint32_t, 3>& triangle,
                             std::uint32_t fourth) const {
    const auto at = [this](std::uint32_t node) {
      const SeenPoint& seen = view_.points[node].seen;
      return Eigen::Vector3d(seen.x, seen.y, seen.z);
    };
    const Eigen::Vector3d first = at(triangle[0]);
    const Eigen::Vector3d normal =
        (at(triangle[1]) - first).cross(at(triangle[2]) - first).normalized();
    const double size = std::max((at(triangle[1]) - first).norm(), (at(fourth) - first).norm());
    // What rounding of the corners themselves leaves of it is in units of the mesh.
    constexpr double kRounding = 1e-15;
    return std::abs(normal.dot(at(fourth) - first)) <= kFlat * size + kRounding * view_.size;
  }

  void connect() {
    const std::vector<CellFace>& faces = view_.mesh.faces;
    const std::vector<Obstruction> others =
        boundary_relations(view_, is_shown_, is_exit_, orientation_);
    order_.n_other_relations = others.size();
    graph_.begins.reserve(n_cells_ + 1);
    auto other = others.begin();
    for (std::uint32_t cell = 0; cell < n_cells_; ++cell) {
      graph_.begins.push_back(static_cast<std::uint32_t>(graph_.targets.size()));
      for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
        const std::uint32_t neighbour = faces[i].neighbour;
        if (is_exit_[i] != 0 && neighbour != kNoCell && is_shown_[neighbour] != 0) {
          graph_.targets.push_back(neighbour);
        }
      }
      order_.n_face_relations += graph_.targets.size() - graph_.begins.back();
      for (; other != others.end() && other->nearer == cell; ++other) {
        graph_.targets.push_back(other->farther);
      }
    }
    graph_.begins.push_back(static_cast<std::uint32_t>(graph_.targets.size()));
  }

  void add_component(std::span<const std::uint32_t> members) {
    if (members.size() == 1) {
      if (is_shown_[members[0]] != 0) {
        order_.back_to_front.push_back({.cell = members[0]});
      }
      return;
    }
    CyclicCells cyclic{.cells = {members.begin(), members.end()}, .cycle = {}};
    std::ranges::sort(cyclic.cells);
    Successors hidden(cyclic.cells.size());
    for (std::uint32_t i = 0; i < cyclic.cells.size(); ++i) {
      for (const std::uint32_t target : graph_.successors_of(cyclic.cells[i])) {
        const auto place = std::ranges::lower_bound(cyclic.cells, target);
        if (place != cyclic.cells.end() && *place == target) {
          hidden[i].push_back(static_cast<std::uint32_t>(place - cyclic.cells.begin()));
        }
      }
      std::ranges::sort(hidden[i]);
      hidden[i].erase(std::unique(hidden[i].begin(), hidden[i].end()), hidden[i].end());
    }
    for (const std::uint32_t member : shortest_cycle(hidden, 0)) {
      cyclic.cycle.push_back(cyclic.cells[member]);
    }
    for (std::uint32_t i = 0; i < hidden.size(); ++i) {
      const auto both = std::ranges::find_if(hidden[i], [&](std::uint32_t other) {
        return std::ranges::binary_search(hidden[other], i);
      });
      if (both == hidden[i].end()) {
        continue;
      }
      cyclic.cells = cyclic.cycle = {cyclic.cells[i], cyclic.cells[*both]};
      throw Error(fmt::format("{}: what is between them is bent", name_of(cyclic, view_)),
                  view_.scene.mesh_file.string(),
                  "render it by casting rays, or split cells with bent faces");
    }
    for (const CellPiece& piece : split_cycles(view_, cyclic.cells, hidden)) {
      order_.back_to_front.push_back(
          {.cell = piece.cell,
           .first_cut = static_cast<std::uint32_t>(order_.cuts.size()),
           .n_cuts = static_cast<std::uint32_t>(piece.cuts.size())});
      order_.cuts.insert(order_.cuts.end(), piece.cuts.begin(), piece.cuts.end());
      ++cyclic.n_pieces;
    }
    order_.cyclic.push_back(std::move(cyclic));
  }

  const VolumeView& view_;
  Orientation orientation_;
  std::size_t n_cells_;
  std::vector<char> is_shown_;
  std::vector<char> is_exit_;  ///< of each face
  Graph graph_;
  VisibilityOrder order_;
};

}  // namespace

VisibilityOrder visibility_order(const VolumeView& view) {
  HAARLIGHT_EXPECTS(view.mesh.tetrahedra.empty(), "faces in the general form");
  return OrderSearch(view).run();
}

std::string name_of(const CyclicCells& cyclic, const VolumeView& view) {
  constexpr std::size_t kNamed = 12;
  std::string names;
  const std::size_t n = std::min(cyclic.cells.size(), kNamed);
  for (std::size_t i = 0; i < n; ++i) {
    const bool is_last = i + 1 == cyclic.cells.size();
    names += (i == 0 ? "" : is_last ? " and " : ", ") + view.cell_name(cyclic.cells[i]);
  }
  if (n < cyclic.cells.size()) {
    names += fmt::format(" and {} more", cyclic.cells.size() - n);
  }
  std::string cycle;
  for (const std::uint32_t cell : cyclic.cycle) {
    cycle += view.cell_name(cell) + " > ";
  }
  return fmt::format("cells {} hide parts of each other in a ring ({}{})", names, cycle,
                     view.cell_name(cyclic.cycle.front()));
}

}  // namespace haarlight::render
