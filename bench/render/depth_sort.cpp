// SPDX-License-Identifier: Apache-2.0
/// @file
/// The sort of [Williams98], section 6, which the renderer does not use: cells by their rearmost depths,
/// each compared with those whose depths overlap its own, and moved behind what it hides; with one list
/// (Stein's) and with n^(1/6) x n^(1/6) tiles. Beside it the order that the renderer finds
/// (visibility_order.h), of the same view. CPU seconds; docs/numerics/volume.md has the table.
///
///     depth_sort SCENE.toml [one]    a volume of tetrahedra; a line of JSON; "one": with one list, too

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <limits>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/cpu_time.h"
#include "haarlight/core/error.h"
#include "render/volume/visibility_order.h"
#include "render/volume/volume_scene.h"
#include "render/volume/volume_view.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

/// Depths and areas on the picture that are no difference: neighbours share edges and faces.
constexpr double kSame = 1e-12;

struct Face {
  Vector3d normal;  ///< outwards
  double offset;    ///< of the plane: normal . x
};

/// As a parallel view along z sees it: perspective keeps planes, and the order along rays.
struct Cell {
  std::array<Vector3d, 4> corners;
  std::array<Face, 4> faces;
  Vector3d low;
  Vector3d high;
};

Cell cell_of(const std::array<Vector3d, 4>& corners) {
  Cell cell{.corners = corners, .faces = {}, .low = corners[0], .high = corners[0]};
  for (std::size_t i = 0; i < 4; ++i) {
    const Vector3d& a = corners.at((i + 1) % 4);
    Vector3d normal =
        (corners.at((i + 2) % 4) - a).cross(corners.at((i + 3) % 4) - a).normalized();
    if (normal.dot(corners.at(i) - a) > 0.0) {
      normal = -normal;
    }
    cell.faces.at(i) = {.normal = normal, .offset = normal.dot(a)};
    cell.low = cell.low.cwiseMin(corners.at(i));
    cell.high = cell.high.cwiseMax(corners.at(i));
  }
  return cell;
}

bool is_outside(const Cell& cell, const Face& face) {
  return std::ranges::all_of(cell.corners, [&](const Vector3d& corner) {
    return face.normal.dot(corner) >= face.offset - kSame;
  });
}

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// Where two edges properly cross on the picture: depth of the first less that of the second.
bool cross_at(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d,
              double& difference) {
  const Vector2d along = (b - a).head<2>();
  const Vector2d other = (d - c).head<2>();
  const double area = cross(along, other);
  if (std::abs(area) < kSame * (along.norm() * other.norm())) {
    return false;
  }
  const Vector2d between = (c - a).head<2>();
  const double s = cross(between, other) / area;
  const double t = cross(between, along) / area;
  constexpr double kProper = 1e-9;  // shared corners decide nothing
  if (s < kProper || s > 1.0 - kProper || t < kProper || t > 1.0 - kProper) {
    return false;
  }
  difference = (a.z() + s * (b.z() - a.z())) - (c.z() + t * (d.z() - c.z()));
  return std::abs(difference) > kSame;
}

/// The middle of what a cell covers of the ray through a point of the picture; false: nothing.
bool middle_on_ray(const Cell& cell, const Vector2d& at, double& middle) {
  double first = -std::numeric_limits<double>::infinity();
  double last = std::numeric_limits<double>::infinity();
  for (const Face& face : cell.faces) {
    const double level = face.offset - face.normal.head<2>().dot(at);
    if (face.normal.z() < 0.0) {
      first = std::max(first, level / face.normal.z());
    } else if (face.normal.z() > 0.0) {
      last = std::min(last, level / face.normal.z());
    } else if (level < 0.0) {
      return false;
    }
  }
  middle = 0.5 * (first + last);
  return first < last - kSame;
}

/// Whether p may hide a part of q, so that it has to be drawn after it. From cheap to costly, section 6:
/// boxes, depths, p behind a back face of q, q before a front face of p, edges, one within the other.
bool hides(const Cell& p, const Cell& q) {
  if (p.high.x() <= q.low.x() || q.high.x() <= p.low.x() || p.high.y() <= q.low.y() ||
      q.high.y() <= p.low.y() || p.low.z() >= q.high.z()) {
    return false;
  }
  for (const Face& face : q.faces) {
    if (face.normal.z() > 0.0 && is_outside(p, face)) {
      return false;
    }
  }
  for (const Face& face : p.faces) {
    if (face.normal.z() < 0.0 && is_outside(q, face)) {
      return false;
    }
  }
  for (std::size_t i = 0; i < 4; ++i) {
    for (std::size_t j = i + 1; j < 4; ++j) {
      for (std::size_t k = 0; k < 4; ++k) {
        for (std::size_t l = k + 1; l < 4; ++l) {
          double difference = 0.0;
          if (cross_at(p.corners.at(i), p.corners.at(j), q.corners.at(k), q.corners.at(l),
                       difference)) {
            return difference < 0.0;
          }
        }
      }
    }
  }
  for (const Cell* inner : {&p, &q}) {
    const Vector2d at =
        (inner->corners[0] + inner->corners[1] + inner->corners[2] + inner->corners[3])
            .head<2>() /
        4.0;
    double of_p = 0.0;
    double of_q = 0.0;
    if (middle_on_ray(p, at, of_p) && middle_on_ray(q, at, of_q)) {
      return of_p < of_q;
    }
  }
  return false;
}

struct Sorted {
  std::vector<std::uint32_t> order;  ///< the farthest first
  double seconds = 0.0;
  std::uint64_t comparisons = 0;
  std::uint64_t rings = 0;  ///< times that a cell would have been moved behind itself
};

class DepthSort {
 public:
  /// @param tiles  across and down
  DepthSort(const std::vector<Cell>& cells, int tiles) : cells_(cells), tiles_(tiles) {
    const double begin = thread_cpu_seconds();
    sort();
    sorted_.seconds = thread_cpu_seconds() - begin;
  }
  [[nodiscard]] const Sorted& sorted() const { return sorted_; }

 private:
  void sort() {
    // The paper's global list; a cell's number is its position in it.
    globally_.resize(cells_.size());
    std::iota(globally_.begin(), globally_.end(), 0U);
    std::ranges::sort(globally_, [this](std::uint32_t a, std::uint32_t b) {
      return cells_[a].high.z() > cells_[b].high.z();
    });
    fill_tiles();
    last_comparison_.assign(cells_.size(), kNobody);
    is_out_.assign(cells_.size(), false);
    is_moved_.assign(cells_.size(), false);
    for (std::uint32_t position = 0; position < cells_.size(); ++position) {
      if (!is_out_[position]) {
        put_out(position);
      }
    }
  }

  void fill_tiles() {
    Vector3d low = cells_[0].low;
    Vector3d high = cells_[0].high;
    for (const Cell& cell : cells_) {
      low = low.cwiseMin(cell.low);
      high = high.cwiseMax(cell.high);
    }
    low_ = low.head<2>();
    per_unit_ = tiles_ / (high - low).head<2>().array();
    lists_.resize(static_cast<std::size_t>(tiles_) * static_cast<std::size_t>(tiles_));
    begins_.assign(lists_.size(), 0);
    for (std::uint32_t position = 0; position < cells_.size(); ++position) {
      for_each_tile(position, [&](std::size_t tile) {
        lists_[tile].push_back(position);
        return true;
      });
    }
  }

  /// While `go_on` says so.
  template <class Function>
  void for_each_tile(std::uint32_t position, const Function& go_on) const {
    const Cell& cell = at(position);
    const auto tile_of = [this](double x, Eigen::Index axis) {
      return std::clamp(static_cast<int>((x - low_[axis]) * per_unit_[axis]), 0, tiles_ - 1);
    };
    for (int y = tile_of(cell.low.y(), 1); y <= tile_of(cell.high.y(), 1); ++y) {
      for (int x = tile_of(cell.low.x(), 0); x <= tile_of(cell.high.x(), 0); ++x) {
        if (!go_on(static_cast<std::size_t>(y * tiles_ + x))) {
          return;
        }
      }
    }
  }

  /// A cell, and before it whatever it hides.
  void put_out(std::uint32_t first) {
    std::vector<std::uint32_t> moved = {first};
    is_moved_[first] = true;
    while (!moved.empty()) {
      const std::uint32_t p = moved.back();
      const std::uint32_t hidden = hidden_by(p);
      if (hidden == kNobody) {
        sorted_.order.push_back(globally_[p]);
        is_out_[p] = true;
        moved.pop_back();
      } else if (is_moved_[hidden]) {
        ++sorted_.rings;
        last_comparison_[hidden] = p;  // let it be
      } else {
        is_moved_[hidden] = true;
        moved.push_back(hidden);
      }
    }
  }

  std::uint32_t hidden_by(std::uint32_t p) {
    const Cell& cell = at(p);
    std::uint32_t found = kNobody;
    for_each_tile(p, [&](std::size_t tile) {
      const std::vector<std::uint32_t>& list = lists_[tile];
      std::size_t& begin = begins_[tile];
      while (begin < list.size() && is_out_[list[begin]]) {
        ++begin;
      }
      for (std::size_t i = begin; i < list.size() && found == kNobody; ++i) {
        const std::uint32_t q = list[i];
        if (is_out_[q] || q == p || last_comparison_[q] == p) {
          continue;
        }
        if (at(q).high.z() <= cell.low.z()) {
          break;  // as all behind it in the list
        }
        ++sorted_.comparisons;
        if (hides(cell, at(q))) {
          found = q;
        } else {
          last_comparison_[q] = p;
        }
      }
      return found == kNobody;
    });
    return found;
  }

  [[nodiscard]] const Cell& at(std::uint32_t position) const {
    return cells_[globally_[position]];
  }

  static constexpr std::uint32_t kNobody = std::numeric_limits<std::uint32_t>::max();
  const std::vector<Cell>& cells_;
  int tiles_;
  Vector2d low_;
  Eigen::Array2d per_unit_;
  std::vector<std::uint32_t> globally_;
  std::vector<std::vector<std::uint32_t>> lists_;  ///< of each tile the positions of its cells
  std::vector<std::size_t> begins_;                ///< of each list: all before it are out
  std::vector<std::uint32_t> last_comparison_;     ///< whom a cell was found to lie before
  std::vector<bool> is_out_;
  std::vector<bool> is_moved_;
  Sorted sorted_;
};

std::vector<Cell> cells_of(const VolumeView& view) {
  const CellMesh& mesh = view.scene.mesh;
  std::vector<Cell> cells;
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    if (mesh.types[i] != CellType::tetrahedron) {
      throw Error("cells that are no tetrahedra", view.scene.mesh_file.string(),
                  "give a mesh of linear tetrahedra", ExitCode::bad_input);
    }
    std::array<Vector3d, 4> corners;
    for (std::size_t k = 0; k < 4; ++k) {
      const SeenPoint& seen = view.points[mesh.nodes_of(i)[k]].seen;
      const bool is_perspective = view.projection == Projection::perspective;
      corners.at(k) = {seen.x, seen.y, is_perspective ? -1.0 / seen.z : seen.z};
    }
    cells.push_back(cell_of(corners));
  }
  return cells;
}

/// Of two cells with a common face, the one behind it comes first. @return how many do not
std::size_t violations(const VolumeView& view, const std::vector<Cell>& cells,
                       const std::vector<std::uint32_t>& order) {
  std::vector<std::size_t> positions(cells.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    positions[order[i]] = i;
  }
  struct Side {
    std::array<std::uint32_t, 3> nodes;
    std::uint32_t cell;
    std::uint32_t corner;  ///< across from it
  };
  std::vector<Side> sides;
  for (std::uint32_t i = 0; i < cells.size(); ++i) {
    const auto nodes = view.scene.mesh.nodes_of(i);
    for (std::uint32_t k = 0; k < 4; ++k) {
      Side side{.nodes = {nodes[(k + 1) % 4], nodes[(k + 2) % 4], nodes[(k + 3) % 4]},
                .cell = i,
                .corner = k};
      std::ranges::sort(side.nodes);
      sides.push_back(side);
    }
  }
  std::ranges::sort(sides, {}, &Side::nodes);
  std::size_t n = 0;
  for (std::size_t i = 1; i < sides.size(); ++i) {
    const Side& a = sides[i - 1];
    const Side& b = sides[i];
    const double z = cells[a.cell].faces.at(a.corner).normal.z();
    if (a.nodes == b.nodes && std::abs(z) > kSame) {
      const bool a_is_nearer = z > 0.0;
      n += (positions[a.cell] > positions[b.cell]) == a_is_nearer ? 0 : 1;
    }
  }
  return n;
}

std::string told(const char* name, int tiles, const Sorted& sorted, std::size_t wrong) {
  return fmt::format(
      R"("{}": {{"tiles": {}, "seconds": {:.4g}, "comparisons": {}, "rings": {}, "violations": {}}})",
      name, tiles, sorted.seconds, sorted.comparisons, sorted.rings, wrong);
}

void run(const std::string& scene_file, bool with_one_list) {
  const VolumeScene scene = read_volume_scene(scene_file);
  const VolumeView view(scene, FaceForm::general);
  const std::vector<Cell> cells = cells_of(view);
  const VisibilityOrder ours = visibility_order(view);
  const int tiles =
      std::max(1, static_cast<int>(std::lround(std::cbrt(std::sqrt(double(cells.size()))))));
  const DepthSort tiled(cells, tiles);
  std::string line =
      fmt::format(R"({{"cells": {}, "ours": {:.4g}, )", cells.size(), ours.cpu_seconds);
  line += told("tiled", tiles, tiled.sorted(), violations(view, cells, tiled.sorted().order));
  if (with_one_list) {
    const DepthSort one(cells, 1);
    line +=
        ", " + told("one_list", 1, one.sorted(), violations(view, cells, one.sorted().order));
  }
  fmt::print("{}}}\n", line);
}

}  // namespace
}  // namespace haarlight::render

int main(int argc, char** argv) {
  try {
    const std::vector<std::string> words(argv + 1, argv + argc);
    if (words.empty() || words.size() > 2 || (words.size() == 2 && words[1] != "one")) {
      fmt::print(stderr, "usage: depth_sort SCENE.toml [one]\n");
      return 2;
    }
    haarlight::render::run(words[0], words.size() == 2);
  } catch (const std::exception& error) {
    fmt::print(stderr, "depth_sort: {}\n", error.what());
    return 1;
  }
  return 0;
}
