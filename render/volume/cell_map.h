// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include <Eigen/Core>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Fields within hexahedra, wedges, pyramids and bent quadratic tetrahedra: isoparametric. A point of the cell is a mean of its
/// corners, weighed by functions of coordinates (r, s, t) in [0, 1]: products of r or 1 - r, s or 1 - s,
/// t or 1 - t; of a wedge 1 - r - s, r and s times t or 1 - t; a pyramid is a hexahedron whose upper
/// corners are one. Of a quadratic tetrahedron all ten nodes count, by b (2 b - 1) for corners and 4 b b'
/// for edges, b of 1 - r - s - t, r, s and t. A field is the same mean of the values there.

namespace haarlight::render {

/// Values at a point, all interpolated.
struct MappedFields {
  double density = 0.0;
  double colour = 0.0;
  double contour = 0.0;
};

/// One cell. Not safe from several threads: it remembers where it last looked.
class CellMap {
 public:
  /// @param corners  of a hexahedron, wedge or pyramid in their order (cell_mesh.h); of a quadratic
  ///                 tetrahedron all nodes
  CellMap(CellType type, std::span<const Eigen::Vector3d> corners,
          std::span<const MappedFields> fields);

  /// Whether (r, s, t) run linearly along a line: parallelepipeds and straight wedges, to rounding.
  [[nodiscard]] bool is_affine() const noexcept { return is_affine_; }
  /// Where a line enters that find() is to go along. Of a quadratic tetrahedron required: others may
  /// have several (r, s, t), of which one is within the cell.
  void begin_at(const Eigen::Vector3d& rst);
  /// (r, s, t) of a point within the cell, by Newton's method from the point before.
  [[nodiscard]] const Eigen::Vector3d& find(const Eigen::Vector3d& point);
  [[nodiscard]] MappedFields fields_of(const Eigen::Vector3d& rst);
  [[nodiscard]] MappedFields at(const Eigen::Vector3d& point) { return fields_of(find(point)); }
  /// How the contour's field changes, at a point within the cell.
  [[nodiscard]] Eigen::Vector3d contour_slope(const Eigen::Vector3d& point);
  /// What rounding of points makes of the fields, about: their range over the cell's thickness.
  [[nodiscard]] MappedFields noise() const noexcept { return noise_; }
  /// How many points it did not find (r, s, t) of, to rounding.
  [[nodiscard]] std::size_t n_lost() const noexcept { return n_lost_; }

 private:
  static constexpr std::size_t kMost = 10;
  [[nodiscard]] bool go_to(const Eigen::Vector3d& point);
  [[nodiscard]] bool go_within(const Eigen::Vector3d& point);
  void find_quadratic_weights(const Eigen::Vector3d& rst);
  [[nodiscard]] bool has_parallel_sides() const;
  void find_weights(const Eigen::Vector3d& rst);

  CellType type_;
  std::size_t n_;
  std::array<Eigen::Vector3d, kMost> corners_;
  std::array<MappedFields, kMost> fields_;
  bool is_affine_ = false;
  double size_ = 0.0;  ///< largest coordinate
  MappedFields noise_;
  Eigen::Vector3d rst_ = Eigen::Vector3d::Constant(1.0 / 3.0);
  Eigen::Vector3d at_ = Eigen::Vector3d::Zero();  ///< of a quadratic tetrahedron: rst_ in space
  // At rst_.
  std::array<double, kMost> weights_{};
  std::array<Eigen::Vector3d, kMost> slopes_;
  std::size_t n_lost_ = 0;
};

}  // namespace haarlight::render
