// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// What may be in the way of a light's points, by direction from the light's centre: a picture of the
/// scene taken from there, whose cells list every edge that may part the light as seen from some
/// receiver in them. It is to soft shadows what the D-buffer of [Jakobsen04] is, but that it keeps
/// all edges instead of a winner: decision 0013.
///
/// All coordinates are of the light frame: z > 0 before the light, lengths in its radii. The image of
/// a point q is q_xy / q_z. A point q hides some point of the unit disk from a receiver x just if
///     |q_xy / q_z - x_xy / x_z| <= 1 / q_z - 1 / x_z:
/// an edge's receivers lie in the hull of two discs about the images of its ends.

namespace haarlight::render {

/// What of an occluder is nearer to the light's plane, or behind it, hides nothing.
inline constexpr double kNearestZ = 1e-9;

class ShadowGrid {
 public:
  /// No cell: one that nothing has been put in.
  struct Cell {
    std::span<const std::uint32_t> edges;  ///< numbers, as they were added
    /// 1 / z of the nearest face whose image meets the cell; 0: none
    double nearest_inverse_z = 0.0;
    /// The same of surfaces that have no edges: spheres, disks.
    double curved_inverse_z = 0.0;
  };

  /// @param receivers  light frame, those that the grid is for: what none of them can see is left out
  /// @param n_cells    across and down
  /// @param rounding   of points: edges are listed also where they part the light but for it
  ShadowGrid(std::span<const Eigen::Vector3d> receivers, int n_cells, double rounding = 0.0);

  /// Keeps of `bounding` and the receivers together those few by which a grid is the same as by all.
  static void add_bounding(std::span<const Eigen::Vector3d> receivers,
                           std::vector<Eigen::Vector3d>& bounding);

  /// Whether the receiver is within what the grid was made for.
  [[nodiscard]] bool covers(const Eigen::Vector3d& receiver) const;

  /// Edges are added twice, the same in the same order: count, then list.
  void count_edge(const Eigen::Vector3d& a, const Eigen::Vector3d& b);
  void start_lists();
  void list_edge(std::uint32_t number, const Eigen::Vector3d& a, const Eigen::Vector3d& b);

  void add_face(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c);
  /// A curved surface that lies within a box. @param half  of the box's sides
  void add_curved(const Eigen::Vector3d& centre, const Eigen::Vector3d& half);

  /// @param receiver  that it covers, z > kNearestZ
  [[nodiscard]] Cell at(const Eigen::Vector3d& receiver) const {
    return cell(cell_of(receiver));
  }
  [[nodiscard]] std::size_t cell_of(const Eigen::Vector3d& receiver) const;
  [[nodiscard]] std::size_t n_cells() const noexcept { return nearest_.size(); }
  [[nodiscard]] Cell cell(std::size_t number) const;
  /// From the light's centre through the cell's middle, unit.
  [[nodiscard]] Eigen::Vector3d direction(std::size_t cell) const;
  /// The longer of its sides in the picture, at z = 1.
  [[nodiscard]] double side(std::size_t cell) const;

  [[nodiscard]] std::size_t n_listed() const noexcept { return listed_.size(); }

 private:
  /// One direction of the picture. Cells are even in xi / (1 + |xi|), so that a wide picture has no
  /// wider cells at its rim.
  struct Axis {
    double low = 0.0;
    double high = 0.0;
    double first = 0.0;  ///< in even coordinates
    double scale = 0.0;
    int n = 1;

    [[nodiscard]] int cell(double xi) const;
    /// Of the cell's lower border; of n: the last one's upper.
    [[nodiscard]] double border(int cell) const;
    [[nodiscard]] double middle(int cell) const;
  };
  struct Disc {
    Eigen::Vector2d centre;
    double radius;
  };

  template <typename Function>
  void for_cells_near(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                      const Function& function) const;
  [[nodiscard]] std::size_t index(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_.n) +
           static_cast<std::size_t>(column);
  }

  Axis columns_;
  Axis rows_;
  double farthest_inverse_z_ = 0.0;  ///< of all receivers
  double rounding_ = 0.0;
  std::vector<std::uint32_t> begins_;
  std::vector<std::uint32_t> ends_;
  std::vector<std::uint32_t> listed_;
  std::vector<float> nearest_;
  std::vector<float> curved_;
};

}  // namespace haarlight::render
