// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include <Eigen/Core>

#include "render/volume/light_sum.h"
#include "render/volume/volume_view.h"

/// @file
/// Cells smaller than a pixel as splats [Williams98, section 5.3]: a cell that covers fewer than two
/// pixels' centres is thought to be in one point, and spread over 3 x 3 pixels by a biquadratic B-spline,
/// in place of being seen by the one ray that happens to pass it, or by none.

namespace haarlight::render {

struct CellSplat {
  Eigen::Array2d centre = Eigen::Array2d::Zero();  ///< pixels, centres at whole numbers
  /// World length of the cell along rays, mean over a pixel, in mm: its volume over what a pixel
  /// covers where it is, across the ray.
  double length = 0.0;
  double extinction = 0.0;  ///< at its centre, 1/mm
  Eigen::Array3d colour = Eigen::Array3d::Zero();
  double depth = 0.0;  ///< of its centre, mm along the camera's axis

  /// The first of its three pixels, of a row and of a column.
  [[nodiscard]] std::array<int, 2> first_pixel() const;
  /// What a pixel's ray gathers of it: a homogeneous stretch of the kernel's part of its length. The
  /// parts of all nine sum to 1, so that the optical depth of the picture is the cell's.
  [[nodiscard]] PixelLight at(int x, int y, Glow glow) const;
};

/// The quadratic B-spline of unit pixels, 0 from 3/2 on. Its sum over all pixels is 1 for any t.
[[nodiscard]] double quadratic_spline(double t);

/// @return  nothing of a cell that covers two pixels' centres or more, on the film or beside it; that
///          is not all in front of the eye and between the clipping planes; of one that is longer than
///          3 pixels (thin ones are not in one point); or that a contour passes. The volume is
///          exact; the centre, and the fields there, are means of the corners: a tetrahedron's centre of
///          gravity, and near it in other cells
[[nodiscard]] std::optional<CellSplat> splat_of(const VolumeView& view, std::uint32_t cell);

}  // namespace haarlight::render
