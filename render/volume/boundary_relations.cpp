// SPDX-License-Identifier: Apache-2.0
#include "render/volume/boundary_relations.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <unordered_map>
#include <utility>

#include <Eigen/Geometry>

#include "render/volume/convex_body.h"

namespace haarlight::render {

using Eigen::Array2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

/// Of the mesh's size: faces nearer to each other than this touch.
constexpr double kTouching = 1e-9;

/// A face of the boundary as it is seen.
struct SeenFace {
  std::array<std::uint32_t, 3> nodes{};  ///< such that det > 0
  std::uint32_t cell = 0;
  VolumeView::SeenBox box;
  double near = 0.0;
  double far = 0.0;
};

/// Numbers of faces by the squares of a grid over the picture that their boxes meet.
class FaceGrid {
 public:
  FaceGrid(const VolumeView& view, std::size_t n_faces)
      : n_(std::clamp(static_cast<int>(std::sqrt(static_cast<double>(n_faces)) / 2.0), 1,
                      kMost)),
        size_(view.scene.camera.width, view.scene.camera.height),
        squares_(static_cast<std::size_t>(n_) * static_cast<std::size_t>(n_)) {}

  struct Square {
    std::vector<std::uint32_t> exits;
    std::vector<std::uint32_t> entries;
  };

  template <class Visit>  // (square)
  void visit(const VolumeView::SeenBox& box, const Visit& visit) {
    const PixelRange across = range(box.low.x(), box.high.x(), size_.x());
    const PixelRange down = range(box.low.y(), box.high.y(), size_.y());
    for (int y = down.first; y < down.end; ++y) {
      for (int x = across.first; x < across.end; ++x) {
        visit(squares_[number(x, y)]);
      }
    }
  }
  /// Of the point of the picture, or the nearest one's.
  [[nodiscard]] std::size_t square_at(const Array2d& at) const {
    return number(index(at.x(), size_.x()), index(at.y(), size_.y()));
  }
  [[nodiscard]] const std::vector<Square>& squares() const { return squares_; }

 private:
  static constexpr int kMost = 1024;
  [[nodiscard]] int index(double at, double size) const {
    return static_cast<int>(std::clamp((at + 0.5) / size * n_, 0.0, n_ - 1.0));
  }
  [[nodiscard]] PixelRange range(double low, double high, double size) const {
    return high < -0.5 || low > size - 0.5
               ? PixelRange{}
               : PixelRange{.first = index(low, size), .end = index(high, size) + 1};
  }
  [[nodiscard]] std::size_t number(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(n_) +
           static_cast<std::size_t>(x);
  }

  int n_;
  Array2d size_;
  std::vector<Square> squares_;
};

class PairTest {
 public:
  PairTest(const VolumeView& view, Orientation& orientation)
      : view_(view), orientation_(orientation), touching_(kTouching * view.size) {}

  /// Whether the insides overlap on the picture, and the face by which rays leave is nearer there.
  [[nodiscard]] bool is_nearer(const SeenFace& exit, const SeenFace& entry) {
    if (view_.projection == Projection::perspective && std::min(exit.near, entry.near) <= 0.0) {
      // They reach behind the eye, where the picture of them is not: of the cells what is before it.
      return hides(view_, body(exit.cell), body(entry.cell));
    }
    find_sides(exit, entry, exit_of_entry_);
    if (is_apart(exit_of_entry_)) {
      return false;
    }
    find_sides(entry, exit, entry_of_exit_);
    if (is_apart(entry_of_exit_)) {
      return false;
    }
    n_places_ = 0;
    exact_ = 0;
    // The corners of what both cover: of one within the other, and where edges cross.
    int order = by_corners(exit, entry, exit_of_entry_, false);
    order = order != 0 ? order : by_corners(entry, exit, entry_of_exit_, true);
    order = order != 0 ? order : by_crossings(exit, entry);
    if (order != 0) {
      return order > 0;
    }
    // They touch. A ray that leaves by a face goes on into what is beyond it, however the two are
    // rounded; but where they share little more than a line, exact signs tell by which it leaves. Rays
    // within that line, to rounding, are in both cells.
    constexpr double kWide = 1e-6;
    constexpr double kLine = 1e-13;
    const double width = relative_width();
    return width > kWide || (width > kLine && exact_ >= 0);
  }

 private:
  /// [edge of one][corner of the other]: the sign of det, > 0 where the corner is on the inside.
  using Sides = std::array<std::array<int, 3>, 3>;

  [[nodiscard]] const ConvexBody& body(std::uint32_t cell) {
    const auto [place, is_new] = bodies_.try_emplace(cell);
    if (is_new) {
      place->second = body_of(view_, cell);
    }
    return place->second;
  }

  void find_sides(const SeenFace& one, const SeenFace& other, Sides& sides) {
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) {
        sides.at(i).at(k) = orientation_.sign(one.nodes.at(i), one.nodes.at(i == 2 ? 0 : i + 1),
                                              other.nodes.at(k));
      }
    }
  }

  /// Triangles that have nothing but borders in common are parted by an edge of one of them.
  [[nodiscard]] static bool is_apart(const Sides& sides) {
    return std::ranges::any_of(sides, [](const std::array<int, 3>& of_edge) {
      return std::ranges::none_of(of_edge, [](int side) { return side > 0; });
    });
  }

  [[nodiscard]] Vector3d position_of(std::uint32_t node) const {
    const SeenPoint& seen = view_.points[node].seen;
    return {seen.x, seen.y, seen.z};
  }

  void add_place(const Vector3d& at) {
    const double w = view_.projection == Projection::perspective ? at.z() : 1.0;
    places_.at(n_places_++) = {at.x() / w, at.y() / w};
  }

  /// Of what both cover, about: in units of its length; 0 of a point.
  [[nodiscard]] double relative_width() const {
    double area = 0.0;
    double length = 0.0;
    for (std::size_t i = 1; i < n_places_; ++i) {
      const Vector2d a = places_.at(i) - places_[0];
      length = std::max(length, a.squaredNorm());
      for (std::size_t k = 1; k < i; ++k) {
        const Vector2d b = places_.at(k) - places_[0];
        area = std::max(area, std::abs(a.x() * b.y() - a.y() * b.x()));
      }
    }
    const double smallest = kTouching * view_.picture_size();
    return length > smallest * smallest ? area / length : 0.0;
  }

  /// Of the other face's corners within `face`: 1 where the exit is nearer than the entry by more than
  /// rounding, -1 where it is farther, 0: neither.
  [[nodiscard]] int by_corners(const SeenFace& face, const SeenFace& other, const Sides& sides,
                               bool is_other_exit) {
    const Vector3d first = position_of(face.nodes[0]);
    const Vector3d away = (position_of(face.nodes[1]) - first)
                              .cross(position_of(face.nodes[2]) - first)
                              .normalized();
    for (std::size_t k = 0; k < 3; ++k) {
      if (sides[0].at(k) < 0 || sides[1].at(k) < 0 || sides[2].at(k) < 0) {
        continue;
      }
      const Vector3d corner = position_of(other.nodes.at(k));
      add_place(corner);
      const double beyond = away.dot(corner - first);
      if (std::abs(beyond) > touching_) {
        return (beyond < 0.0) == is_other_exit ? 1 : -1;
      }
      if (exact_ == 0) {
        const int side = orientation_.side_of_plane(face.nodes[0], face.nodes[1], face.nodes[2],
                                                    other.nodes.at(k));
        exact_ = is_other_exit ? -side : side;
      }
    }
    return 0;
  }

  [[nodiscard]] int by_crossings(const SeenFace& exit, const SeenFace& entry) {
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t next_i = i == 2 ? 0 : i + 1;
        const std::size_t next_k = k == 2 ? 0 : k + 1;
        const int side = exit_of_entry_.at(i).at(k);
        if (side * exit_of_entry_.at(i).at(next_k) >= 0 ||
            entry_of_exit_.at(k).at(i) * entry_of_exit_.at(k).at(next_i) >= 0) {
          continue;
        }
        const std::uint32_t a = exit.nodes.at(i);
        const std::uint32_t b = exit.nodes.at(next_i);
        const std::uint32_t c = entry.nodes.at(k);
        const std::uint32_t d = entry.nodes.at(next_k);
        const double of_a = orientation_.value(c, d, a);
        const double of_b = orientation_.value(c, d, b);
        const double s = of_a != of_b ? std::clamp(of_a / (of_a - of_b), 0.0, 1.0) : 0.5;
        add_place((1.0 - s) * position_of(a) + s * position_of(b));
        // Where cd crosses the plane of a, b and the eye it is beyond ab if d is beyond abc.
        const Vector3d across = (position_of(b) - position_of(a))
                                    .cross(position_of(d) - position_of(c))
                                    .normalized();
        const double apart = std::abs(across.dot(position_of(c) - position_of(a)));
        const int order = side * orientation_.side_of_plane(a, b, c, d);
        if (apart > touching_ && order != 0) {
          return order;
        }
        if (exact_ == 0) {
          exact_ = order;
        }
      }
    }
    return 0;
  }

  const VolumeView& view_;
  Orientation& orientation_;
  double touching_;
  std::unordered_map<std::uint32_t, ConvexBody> bodies_;  ///< of cells about the eye
  Sides exit_of_entry_{};  ///< edges of the exit, corners of the entry
  Sides entry_of_exit_{};
  std::array<Vector2d, 15> places_;  ///< corners of what both cover, on the picture
  std::size_t n_places_ = 0;
  int exact_ = 0;  ///< 1 where the exit is nearer, by however little; -1: farther
};

}  // namespace

std::vector<Obstruction> boundary_relations(const VolumeView& view,
                                            std::span<const char> is_shown,
                                            std::span<const char> is_exit_face,
                                            Orientation& orientation) {
  std::vector<SeenFace> faces;
  std::vector<char> is_exit;
  for (std::uint32_t cell = 0; cell + 1 < view.mesh.begins.size(); ++cell) {
    if (is_shown[cell] == 0) {
      continue;
    }
    for (std::uint32_t i = view.mesh.begins[cell]; i < view.mesh.begins[cell + 1]; ++i) {
      const CellFace& face = view.mesh.faces[i];
      if (face.neighbour != kNoCell) {
        continue;
      }
      const int sign = orientation.sign(face.nodes[0], face.nodes[1], face.nodes[2]);
      if (sign == 0 || (sign > 0) != (is_exit_face[i] != 0)) {
        continue;
      }
      SeenFace seen{.nodes = face.nodes, .cell = cell, .box = view.box_of(face.nodes)};
      if (sign < 0) {
        std::swap(seen.nodes[1], seen.nodes[2]);
      }
      const auto z_of = [&](std::size_t k) { return view.points[face.nodes.at(k)].seen.z; };
      seen.near = std::min({z_of(0), z_of(1), z_of(2)});
      seen.far = std::max({z_of(0), z_of(1), z_of(2)});
      if (seen.far <= view.near) {
        continue;
      }
      faces.push_back(seen);
      is_exit.push_back(sign > 0 ? 1 : 0);
    }
  }
  FaceGrid grid(view, faces.size());
  for (std::uint32_t i = 0; i < faces.size(); ++i) {
    grid.visit(faces[i].box, [&](FaceGrid::Square& square) {
      (is_exit[i] != 0 ? square.exits : square.entries).push_back(i);
    });
  }
  std::vector<Obstruction> found;
  PairTest test(view, orientation);
  for (std::size_t i = 0; i < grid.squares().size(); ++i) {
    const FaceGrid::Square& square = grid.squares()[i];
    for (const std::uint32_t number : square.exits) {
      const SeenFace& exit = faces[number];
      for (const std::uint32_t other : square.entries) {
        const SeenFace& entry = faces[other];
        if (exit.cell == entry.cell || exit.near > entry.far + kTouching * view.size) {
          continue;
        }
        const Array2d low = exit.box.low.max(entry.box.low);
        // Each pair once: in the square of the corner of what both boxes cover.
        if ((low > exit.box.high.min(entry.box.high)).any() || grid.square_at(low) != i) {
          continue;
        }
        if (test.is_nearer(exit, entry)) {
          found.push_back({.nearer = exit.cell, .farther = entry.cell});
        }
      }
    }
  }
  std::ranges::sort(found, [](const Obstruction& a, const Obstruction& b) {
    return a.nearer != b.nearer ? a.nearer < b.nearer : a.farther < b.farther;
  });
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

}  // namespace haarlight::render
