// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include <Eigen/Core>

#include "render/cell_mesh/cell_mesh.h"
#include "render/cell_mesh/shape_functions.h"

/// @file
/// Fields within cells other than linear tetrahedra: isoparametric. Points of the cell and its fields are means
/// of those of its nodes, by its shape functions (shape_functions.h) of coordinates (r, s, t). Where nothing is
/// bent the corners say where points are, and all nodes what the fields are.

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
  enum class Shape : bool { straight, bent };

  /// @param nodes  in their order (cell_mesh.h)
  CellMap(CellType type, std::span<const Eigen::Vector3d> nodes,
          std::span<const MappedFields> fields, Shape shape = Shape::straight);

  /// Whether (r, s, t) run linearly along a line: tetrahedra, parallelepipeds and straight wedges, to
  /// rounding.
  [[nodiscard]] bool is_affine() const noexcept { return is_affine_; }
  /// Where a line enters that find() is to go along. Of a bent cell required: it may have several (r, s, t)
  /// for a point, of which one is within the cell.
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
  [[nodiscard]] bool go_to(const Eigen::Vector3d& point);
  [[nodiscard]] bool go_within(const Eigen::Vector3d& point);
  [[nodiscard]] bool has_parallel_sides() const;
  /// At rst_, by the shape functions there.
  [[nodiscard]] Eigen::Matrix3d jacobian() const;

  CellType type_;   ///< of the fields
  CellType place_;  ///< of the positions: linear unless bent
  std::size_t n_ = 0;
  std::size_t n_placed_ = 0;
  std::array<Eigen::Vector3d, kMostCellNodes> nodes_;
  std::array<MappedFields, kMostCellNodes> fields_;
  bool is_affine_ = false;
  double size_ = 0.0;  ///< largest coordinate
  MappedFields noise_;
  Eigen::Vector3d rst_ = Eigen::Vector3d::Constant(1.0 / 3.0);
  Eigen::Vector3d at_ = Eigen::Vector3d::Zero();  ///< of a bent cell: rst_ in space
  ShapeFunctions of_place_;                       ///< at rst_
  ShapeFunctions of_fields_;
  std::size_t n_lost_ = 0;
};

}  // namespace haarlight::render
