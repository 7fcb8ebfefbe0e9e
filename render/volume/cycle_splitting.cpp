// SPDX-License-Identifier: Apache-2.0
#include "render/volume/cycle_splitting.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/volume/strong_components.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Of the mesh's size: what a cut must leave on either side of its plane.
constexpr double kThinnest = 1e-9;
/// Of the smaller picture of two pieces: what they must share of it to hide each other.
constexpr double kLeastOverlap = 1e-10;

using Polygon = std::vector<Vector3d>;
using FlatPolygon = std::vector<Vector2d>;

/// In the camera's frame.
struct Polyhedron {
  std::vector<Polygon> faces;  ///< but for those that cuts made: their edges are in the others
  std::vector<HalfSpace> planes;  ///< all
};

/// What of the polygon is within [Sutherland74].
Polygon clipped(const Polygon& polygon, const HalfSpace& half) {
  Polygon kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3d& from = polygon[i];
    const Vector3d& to = polygon[i + 1 == polygon.size() ? 0 : i + 1];
    const double of_from = half.normal.dot(from) - half.offset;
    const double of_to = half.normal.dot(to) - half.offset;
    if (of_from <= 0.0) {
      kept.push_back(from);
    }
    if ((of_from < 0.0 && of_to > 0.0) || (of_from > 0.0 && of_to < 0.0)) {
      kept.emplace_back(from + of_from / (of_from - of_to) * (to - from));
    }
  }
  return kept;
}

Polyhedron clipped(const Polyhedron& body, const HalfSpace& half) {
  Polyhedron kept;
  for (const Polygon& face : body.faces) {
    Polygon polygon = clipped(face, half);
    if (polygon.size() >= 3) {
      kept.faces.push_back(std::move(polygon));
    }
  }
  kept.planes = body.planes;
  kept.planes.push_back(half);
  return kept;
}

HalfSpace opposite(const HalfSpace& half) {
  return {.normal = -half.normal, .offset = -half.offset};
}

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double area_of(const FlatPolygon& polygon) {
  double sum = 0.0;
  for (std::size_t i = 2; i < polygon.size(); ++i) {
    sum += cross(polygon[i - 1] - polygon[0], polygon[i] - polygon[0]);
  }
  return 0.5 * sum;
}

/// Anticlockwise where y points up: Andrew's monotone chain.
FlatPolygon hull_of(FlatPolygon points) {
  std::ranges::sort(points, [](const Vector2d& a, const Vector2d& b) {
    return a.x() != b.x() ? a.x() < b.x() : a.y() < b.y();
  });
  FlatPolygon hull;
  for (int way = 0; way < 2; ++way) {
    const std::size_t first = hull.size();
    for (const Vector2d& point : points) {
      while (hull.size() >= first + 2 &&
             cross(hull.back() - hull[hull.size() - 2], point - hull.back()) <= 0.0) {
        hull.pop_back();
      }
      hull.push_back(point);
    }
    hull.pop_back();
    std::ranges::reverse(points);
  }
  return hull;
}

/// What two convex polygons, anticlockwise, have in common.
FlatPolygon common_part(FlatPolygon polygon, const FlatPolygon& other) {
  for (std::size_t k = 0; k < other.size() && !polygon.empty(); ++k) {
    const Vector2d& a = other[k];
    const Vector2d along = other[k + 1 == other.size() ? 0 : k + 1] - a;
    FlatPolygon kept;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Vector2d& from = polygon[i];
      const Vector2d& to = polygon[i + 1 == polygon.size() ? 0 : i + 1];
      const double of_from = cross(along, from - a);
      const double of_to = cross(along, to - a);
      if (of_from >= 0.0) {
        kept.push_back(from);
      }
      if ((of_from < 0.0 && of_to > 0.0) || (of_from > 0.0 && of_to < 0.0)) {
        kept.emplace_back(from + of_from / (of_from - of_to) * (to - from));
      }
    }
    polygon = std::move(kept);
  }
  return polygon;
}

/// Pieces of a component's cells, and which hides which.
class Splitting {
 public:
  Splitting(const VolumeView& view, std::span<const std::uint32_t> cells,
            const Successors& hidden)
      : view_(view), cells_(cells), hidden_(hidden), obstructing_(hidden.size()) {
    for (std::uint32_t i = 0; i < hidden.size(); ++i) {
      for (const std::uint32_t other : hidden[i]) {
        obstructing_[other].push_back(i);
      }
    }
    for (const std::uint32_t cell : cells) {
      pieces_.push_back(
          {.piece = {.cell = cell, .cuts = {}}, .body = body_of(cell), .hull = {}});
      pieces_.back().hull = seen_hull(pieces_.back().body);
    }
  }

  [[nodiscard]] std::vector<CellPiece> run() {
    const std::size_t most = 1000 + 64 * cells_.size();
    while (true) {
      std::vector<std::vector<std::uint32_t>> components;
      for_each_component(
          hidden_.size(),
          [this](std::uint32_t node) { return std::span<const std::uint32_t>(hidden_[node]); },
          [&](std::span<const std::uint32_t> members) {
            components.emplace_back(members.begin(), members.end());
          });
      bool is_ordered = true;
      for (const std::vector<std::uint32_t>& component : components) {
        if (component.size() > 1) {
          is_ordered = false;
          if (pieces_.size() > most || !split_one(shortest_cycle(hidden_, component[0]))) {
            throw_unordered(component);
          }
        }
      }
      if (is_ordered) {
        std::vector<CellPiece> ordered;
        for (const std::vector<std::uint32_t>& component : components) {
          ordered.push_back(std::move(pieces_[component[0]].piece));
        }
        return ordered;
      }
    }
  }

 private:
  struct Piece {
    CellPiece piece;
    Polyhedron body;
    FlatPolygon hull;  ///< on the picture
  };

  [[noreturn]] void throw_unordered(const std::vector<std::uint32_t>& component) const {
    constexpr std::size_t kNamed = 8;
    std::string names;
    for (std::size_t i = 0; i < std::min(component.size(), kNamed); ++i) {
      names += (i > 0 ? ", " : "") + view_.cell_name(pieces_[component[i]].piece.cell);
    }
    throw Error(
        fmt::format("cells {}{} hide parts of each other in a ring that cuts do not open",
                    names, component.size() > kNamed ? " and others" : ""),
        view_.scene.mesh_file.string(), "render it by casting rays");
  }

  [[nodiscard]] Vector3d position_of(std::uint32_t node) const {
    const SeenPoint& seen = view_.points[node].seen;
    return {seen.x, seen.y, seen.z};
  }

  /// In perspective only what is in front of the eye.
  [[nodiscard]] Polyhedron body_of(std::uint32_t cell) const {
    Polyhedron body;
    for (std::uint32_t i = view_.mesh.begins[cell]; i < view_.mesh.begins[cell + 1]; ++i) {
      const std::array<std::uint32_t, 3>& nodes = view_.mesh.faces[i].nodes;
      const Vector3d a = position_of(nodes[0]);
      const Vector3d b = position_of(nodes[1]);
      const Vector3d c = position_of(nodes[2]);
      const Vector3d normal = (b - a).cross(c - a).normalized();
      body.faces.push_back({a, b, c});
      body.planes.push_back({.normal = normal, .offset = normal.dot(a)});
    }
    if (view_.projection == Projection::perspective) {
      const double near = std::max(view_.near, kThinnest * view_.size);
      const HalfSpace in_front{.normal = -Vector3d::UnitZ(), .offset = -near};
      const auto is_behind = [near](const Vector3d& point) { return point.z() < near; };
      if (std::ranges::any_of(body.faces, [&](const Polygon& face) {
            return std::ranges::any_of(face, is_behind);
          })) {
        return clipped(body, in_front);
      }
    }
    return body;
  }

  [[nodiscard]] FlatPolygon seen_hull(const Polyhedron& body) const {
    FlatPolygon points;
    for (const Polygon& face : body.faces) {
      for (const Vector3d& corner : face) {
        const double w = view_.projection == Projection::perspective ? corner.z() : 1.0;
        points.emplace_back(corner.x() / w, corner.y() / w);
      }
    }
    return points.empty() ? points : hull_of(std::move(points));
  }

  /// Where the body is along the ray of a picture point, as its middle.
  [[nodiscard]] double middle_of(const Polyhedron& body, const Vector2d& p) const {
    const Vector3d origin = view_.point_at(p, 0.0);
    const Vector3d along = view_.point_at(p, 1.0) - origin;
    double enters = -std::numeric_limits<double>::infinity();
    double leaves = std::numeric_limits<double>::infinity();
    for (const HalfSpace& plane : body.planes) {
      const double slope = plane.normal.dot(along);
      const double z = (plane.offset - plane.normal.dot(origin)) / slope;
      if (slope < 0.0) {
        enters = std::max(enters, z);
      } else if (slope > 0.0) {
        leaves = std::min(leaves, z);
      }
    }
    return 0.5 * enters + 0.5 * leaves;
  }

  /// Whether a hides a part of b: where convex bodies share a part of the picture one is nearer.
  [[nodiscard]] bool hides(const Piece& a, const Piece& b) const {
    const FlatPolygon common = common_part(a.hull, b.hull);
    const double area = area_of(common);
    if (!(area > kLeastOverlap * std::min(area_of(a.hull), area_of(b.hull)))) {
      return false;
    }
    Vector2d middle = Vector2d::Zero();
    for (const Vector2d& corner : common) {
      middle += corner;
    }
    middle /= static_cast<double>(common.size());
    return middle_of(a.body, middle) < middle_of(b.body, middle);
  }

  /// The two sides of a plane, if it leaves something on both.
  [[nodiscard]] std::optional<std::array<Piece, 2>> cut(const Piece& whole,
                                                        const HalfSpace& half) const {
    double low = 0.0;
    double high = 0.0;
    for (const Polygon& face : whole.body.faces) {
      for (const Vector3d& corner : face) {
        const double beyond = half.normal.dot(corner) - half.offset;
        low = std::min(low, beyond);
        high = std::max(high, beyond);
      }
    }
    const double thinnest = kThinnest * view_.size;
    if (low > -thinnest || high < thinnest) {
      return std::nullopt;
    }
    std::array<Piece, 2> sides;
    for (std::size_t i = 0; i < 2; ++i) {
      const HalfSpace side = i == 0 ? half : opposite(half);
      Piece& piece = sides.at(i);
      piece.piece = whole.piece;
      piece.piece.cuts.push_back(side);
      piece.body = clipped(whole.body, side);
      piece.hull = seen_hull(piece.body);
    }
    return sides;
  }

  /// Whether the way from the piece before a cut one in a cycle to that behind it is closed.
  [[nodiscard]] bool opens(const std::array<Piece, 2>& sides, const Piece& before,
                           const Piece& behind) const {
    const std::array from = {hides(before, sides[0]), hides(before, sides[1])};
    const std::array to = {hides(sides[0], behind), hides(sides[1], behind)};
    return !(from[0] && to[0]) && !(from[1] && to[1]) &&
           !(from[0] && to[1] && hides(sides[0], sides[1])) &&
           !(from[1] && to[0] && hides(sides[1], sides[0]));
  }

  /// Cuts one piece of a cycle by a plane of another: so that it opens, else by any.
  /// @return  whether there is one to cut by
  [[nodiscard]] bool split_one(const std::vector<std::uint32_t>& cycle) {
    std::optional<std::array<Piece, 2>> any;
    std::uint32_t any_number = 0;
    for (std::size_t i = 0; i < cycle.size(); ++i) {
      const Piece& before = pieces_[cycle[i == 0 ? cycle.size() - 1 : i - 1]];
      const Piece& behind = pieces_[cycle[i + 1 == cycle.size() ? 0 : i + 1]];
      for (std::size_t k = 1; k < cycle.size(); ++k) {  // from the next one on
        for (const HalfSpace& plane : pieces_[cycle[(i + k) % cycle.size()]].body.planes) {
          std::optional<std::array<Piece, 2>> sides = cut(pieces_[cycle[i]], plane);
          if (sides && opens(*sides, before, behind)) {
            replace(cycle[i], std::move(*sides));
            return true;
          }
          if (sides && !any) {
            any = std::move(sides);
            any_number = cycle[i];
          }
        }
      }
    }
    if (any) {
      replace(any_number, std::move(*any));
    }
    return any.has_value();
  }

  /// The piece by its two sides. A ray goes on from one of them to where it went on from the whole, or
  /// to the other.
  void replace(std::uint32_t number, std::array<Piece, 2> sides) {
    const auto added = static_cast<std::uint32_t>(pieces_.size());
    const std::vector<std::uint32_t> hidden = std::exchange(hidden_[number], {});
    const std::vector<std::uint32_t> obstructing = std::exchange(obstructing_[number], {});
    for (const std::uint32_t other : hidden) {
      std::erase(obstructing_[other], number);
    }
    for (const std::uint32_t other : obstructing) {
      std::erase(hidden_[other], number);
    }
    hidden_.emplace_back();
    obstructing_.emplace_back();
    pieces_[number] = std::move(sides[0]);
    pieces_.push_back(std::move(sides[1]));
    for (const std::uint32_t piece : {number, added}) {
      for (const std::uint32_t other : hidden) {
        connect_if_hidden(piece, other);
      }
      for (const std::uint32_t other : obstructing) {
        connect_if_hidden(other, piece);
      }
    }
    connect_if_hidden(number, added);
    connect_if_hidden(added, number);
  }

  void connect_if_hidden(std::uint32_t nearer, std::uint32_t farther) {
    if (hides(pieces_[nearer], pieces_[farther])) {
      hidden_[nearer].push_back(farther);
      obstructing_[farther].push_back(nearer);
    }
  }

  const VolumeView& view_;
  std::span<const std::uint32_t> cells_;
  std::vector<Piece> pieces_;
  Successors hidden_;
  Successors obstructing_;
};

}  // namespace

std::vector<std::uint32_t> shortest_cycle(const Successors& graph, std::uint32_t node) {
  constexpr std::uint32_t kNew = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> from(graph.size(), kNew);
  std::vector<std::uint32_t> queue = {node};
  for (std::size_t i = 0; i < queue.size(); ++i) {
    for (const std::uint32_t next : graph[queue[i]]) {
      if (next == node) {
        std::vector<std::uint32_t> cycle;
        for (std::uint32_t at = queue[i]; at != node; at = from[at]) {
          cycle.push_back(at);
        }
        cycle.push_back(node);
        std::ranges::reverse(cycle);
        return cycle;
      }
      if (from[next] == kNew) {
        from[next] = queue[i];
        queue.push_back(next);
      }
    }
  }
  return {};
}

std::vector<CellPiece> split_cycles(const VolumeView& view,
                                    std::span<const std::uint32_t> cells,
                                    const Successors& hidden) {
  return Splitting(view, cells, hidden).run();
}

}  // namespace haarlight::render
