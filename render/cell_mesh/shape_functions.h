// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>

#include <Eigen/Core>

#include "render/cell_mesh/cell_mesh.h"

/// @file
/// Shape functions of all types of cells: a point of the cell is the mean of its nodes with these weights,
/// a field there the same mean of the nodes' values. They are those of VTK.
///
/// Coordinates (r, s, t) are in [0, 1]. With b = 1 - r - s - t, r, s, t:
///
///     tetrahedron    b; quadratic b (2 b - 1) and 4 b b'; cubic b (3 b - 1) (3 b - 2)/2,
///                    9/2 b b' (3 b - 1) and 27 b b' b''
///     hexahedron     products of r or 1 - r, s or 1 - s, t or 1 - t; quadratic the serendipity functions,
///                    triquadratic products of the parabolas through 0, 1/2 and 1
///     wedge          r, s or 1 - r - s times t or 1 - t; quadratic the serendipity functions
///     pyramid        a hexahedron whose upper corners are one; the quadratic one besides such that its
///                    triangles are those of quadratic tetrahedra: with x = r or 1 - r and y = s or 1 - s
///                    4 r (1 - r) y (1 - t (2 y - 1)) (1 - t) along the base's edges, 4 x y t (1 - t) along the
///                    others, t (2 t - 1) at the tip, at a corner what is linear less half of its edges'
///
/// Of a pyramid r and s are any at its tip.

namespace haarlight::render {

struct ShapeFunctions {
  std::array<double, kMostCellNodes> weights{};
  std::array<Eigen::Vector3d, kMostCellNodes> slopes;  ///< by r, s, t
};

void find_shape(CellType type, const Eigen::Vector3d& rst, ShapeFunctions& shape);

/// Of a pyramid's: its slopes by r and s over 1 - t, which exist at its tip as well.
void find_shape_over_height(CellType type, const Eigen::Vector3d& rst, ShapeFunctions& shape);

/// (r, s, t) of a point of a face by the weights of its corners. Of a triangle of a pyramid, a mean that is
/// right but for r and s at the tip.
[[nodiscard]] Eigen::Vector3d coordinates_between(CellType type,
                                                  const std::array<std::uint8_t, 3>& corners,
                                                  const std::array<double, 3>& weights);
/// The same of all of a bent face; corners and weights as those of nodes_of_face().
[[nodiscard]] Eigen::Vector3d coordinates_on_face(CellType type, std::size_t side,
                                                  const std::array<double, 4>& weights);

/// How far (r, s, t) are within the cell; negative: outside of it.
[[nodiscard]] double depth_within(CellType type, const Eigen::Vector3d& rst);

}  // namespace haarlight::render
