// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_surface.h"

#include <array>
#include <cstddef>
#include <cstdint>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;
using Cell = std::array<int, 3>;

constexpr std::array<std::uint8_t, 3> kGrey{176, 176, 176};
constexpr std::array<std::uint8_t, 3> kOrange{230, 120, 40};
constexpr double kCancelled = 1e-9;
constexpr std::uint32_t kNone = 0xffffffffU;

/// One side of a voxel that is matter, where its neighbour is not.
struct Side {
  std::array<std::uint32_t, 4> corners{};  ///< anticlockwise, seen from outside
};

class Nets {
 public:
  explicit Nets(const ShadowHull& hull) : hull_(hull), grid_(hull.grid) { find_sides(); }

  void smooth(int n) {
    const std::vector<std::array<std::uint32_t, 2>> edges = find_edges();
    for (int round = 0; round < n; ++round) {
      move(edges, kShrink);
      move(edges, kGrow);
    }
  }

  [[nodiscard]] render::SurfaceMesh mesh() const {
    render::SurfaceMesh mesh;
    // Two triangles per side, along the shorter diagonal.
    for (const Side& side : sides_) {
      const auto& [a, b, c, d] = side.corners;
      if ((at_[a] - at_[c]).squaredNorm() <= (at_[b] - at_[d]).squaredNorm()) {
        mesh.triangles.push_back({a, b, c});
        mesh.triangles.push_back({a, c, d});
      } else {
        mesh.triangles.push_back({a, b, d});
        mesh.triangles.push_back({b, c, d});
      }
    }
    std::vector<Vector3d> world;
    std::vector<Vector3d> normals(at_.size(), Vector3d::Zero());
    world.reserve(at_.size());
    for (const Vector3d& at : at_) {
      world.push_back(grid_.world_of(at));
    }
    for (const auto& [a, b, c] : mesh.triangles) {
      const Vector3d area = (world[b] - world[a]).cross(world[c] - world[a]);
      normals[a] += area;
      normals[b] += area;
      normals[c] += area;
    }
    // Where the surface touches itself its sides can cancel: one of them tells then.
    for (const auto& [a, b, c] : mesh.triangles) {
      const Vector3d area = (world[b] - world[a]).cross(world[c] - world[a]);
      for (const std::uint32_t i : {a, b, c}) {
        if (normals[i].norm() < kCancelled * area.norm()) {
          normals[i] = area;
        }
      }
    }
    for (std::size_t i = 0; i < at_.size(); ++i) {
      mesh.vertices.push_back(as_floats(world[i]));
      const bool is_flat = normals[i].isZero(0.0);  // all its triangles have shrunk to lines
      mesh.normals.push_back(as_floats(is_flat ? grid_.axes[2] : normals[i].normalized()));
      mesh.colours.push_back(is_matter_[i] != 0 ? kGrey : kOrange);
    }
    return mesh;
  }

 private:
  static constexpr double kReach = 0.5;  // voxels
  // lambda and mu of Taubin's filter: after 12 rounds a twig one voxel wide has half its width,
  // where means alone would let it vanish.
  static constexpr double kShrink = 0.5;
  static constexpr double kGrow = -0.526;

  /// Every vertex by this part of the way to the mean of its neighbours.
  void move(const std::vector<std::array<std::uint32_t, 2>>& edges, double part) {
    sums_.assign(corners_.size(), Vector3d::Zero());
    counts_.assign(corners_.size(), 0);
    for (const auto& [a, b] : edges) {
      sums_[a] += at_[b];
      sums_[b] += at_[a];
      ++counts_[a];
      ++counts_[b];
    }
    for (std::size_t i = 0; i < corners_.size(); ++i) {
      const Vector3d corner = corner_of(i);
      at_[i] = (at_[i] + part * (sums_[i] / counts_[i] - at_[i]))
                   .cwiseMax(corner - Vector3d::Constant(kReach))
                   .cwiseMin(corner + Vector3d::Constant(kReach));
    }
  }

  static std::array<float, 3> as_floats(const Vector3d& v) {
    return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
  }
  [[nodiscard]] Vector3d corner_of(std::size_t i) const {
    return {static_cast<double>(corners_[i][0]), static_cast<double>(corners_[i][1]),
            static_cast<double>(corners_[i][2])};
  }
  [[nodiscard]] VoxelState state(const Cell& c) const {
    const bool is_inside = c[0] >= 0 && c[1] >= 0 && c[2] >= 0 && c[0] < grid_.nx &&
                           c[1] < grid_.ny && c[2] < grid_.nz;
    return is_inside ? hull_.states[grid_.index(c[0], c[1], c[2])] : VoxelState::empty;
  }
  [[nodiscard]] bool is_full(const Cell& c) const { return is_taken_as_matter(state(c)); }

  /// The vertex of a voxel's corner.
  std::uint32_t vertex(const Cell& c) {
    const std::size_t i =
        (static_cast<std::size_t>(c[2]) * static_cast<std::size_t>(grid_.ny + 1) +
         static_cast<std::size_t>(c[1])) *
            static_cast<std::size_t>(grid_.nx + 1) +
        static_cast<std::size_t>(c[0]);
    if (index_[i] == kNone) {
      index_[i] = static_cast<std::uint32_t>(corners_.size());
      corners_.push_back(c);
      is_matter_.push_back(0);
    }
    return index_[i];
  }

  /// All sides between what is taken as matter and what is not.
  void find_sides() {
    index_.assign(static_cast<std::size_t>(grid_.nx + 1) *
                      static_cast<std::size_t>(grid_.ny + 1) *
                      static_cast<std::size_t>(grid_.nz + 1),
                  kNone);
    // The grid's axes are left-handed where the lights are behind the plane.
    const bool is_right = grid_.axes[0].cross(grid_.axes[1]).dot(grid_.axes[2]) > 0.0;
    for (int z = 0; z < grid_.nz; ++z) {
      for (int y = 0; y < grid_.ny; ++y) {
        for (int x = 0; x < grid_.nx; ++x) {
          if (is_full({x, y, z})) {
            add_sides({x, y, z}, is_right);
          }
        }
      }
    }
    index_.clear();
    index_.shrink_to_fit();
    for (std::size_t i = 0; i < corners_.size(); ++i) {
      at_.push_back(corner_of(i));
    }
  }

  void add_sides(const Cell& cell, bool is_right) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (const int step : {-1, 1}) {
        Cell neighbour = cell;
        neighbour[axis] += step;
        if (is_full(neighbour)) {
          continue;
        }
        Cell corner = cell;
        corner[axis] += step > 0 ? 1 : 0;
        const std::size_t u = (axis + 1) % 3;
        const std::size_t v = (axis + 2) % 3;
        Side side;
        constexpr std::array<std::array<int, 2>, 4> kAround{{{0, 0}, {1, 0}, {1, 1}, {0, 1}}};
        for (std::size_t i = 0; i < 4; ++i) {
          Cell at = corner;
          // u x v is the axis: anticlockwise from its far end.
          const auto& around = kAround[(step > 0) == is_right ? i : 3 - i];
          at[u] += around[0];
          at[v] += around[1];
          side.corners[i] = vertex(at);
          if (state(cell) == VoxelState::matter) {
            is_matter_[side.corners[i]] = 1;
          }
        }
        sides_.push_back(side);
      }
    }
  }

  /// The sides' edges; one that several sides share is there once per side.
  [[nodiscard]] std::vector<std::array<std::uint32_t, 2>> find_edges() const {
    std::vector<std::array<std::uint32_t, 2>> edges;
    edges.reserve(4 * sides_.size());
    for (const Side& side : sides_) {
      for (std::size_t i = 0; i < 4; ++i) {
        edges.push_back({side.corners[i], side.corners[(i + 1) % 4]});
      }
    }
    return edges;
  }

  const ShadowHull& hull_;
  const VoxelGrid& grid_;
  std::vector<Side> sides_;
  std::vector<Cell> corners_;            ///< of each vertex: grid coordinates before smoothing
  std::vector<std::uint8_t> is_matter_;  ///< of each vertex: a voxel at it surely is
  std::vector<Vector3d> at_;             ///< of each vertex, grid coordinates
  std::vector<std::uint32_t> index_;     ///< vertex of each corner of the grid
  std::vector<Vector3d> sums_;           ///< of each vertex's neighbours
  std::vector<int> counts_;
};

}  // namespace

render::SurfaceMesh hull_surface(const ShadowHull& hull, const HullSurfaceOptions& options) {
  HAARLIGHT_EXPECTS(hull.states.size() == hull.grid.size() && options.n_smoothings >= 0,
                    "a state per voxel");
  Nets nets(hull);
  nets.smooth(options.n_smoothings);
  return nets.mesh();
}

}  // namespace haarlight::relight
