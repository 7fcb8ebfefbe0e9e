// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/relight/shape/integrate_normals.h"
#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// What a shadow hull adds to heights from normals. Normals do not show that one part of a
/// surface stands higher than its neighbour in the picture; the hull bounds each pixel's
/// distance from the camera: loosely in the middle of a part, closely at its outline. Where a
/// surface leaves these bounds, part of it must stand elsewhere, and the cheapest division of the
/// picture says which (docs/numerics/shape.md, "With the shadow hull").

namespace haarlight::relight {

/// ln of the distance from the camera, (height, width); high not above low: nothing is known.
struct DepthBounds {
  Image<float> low;
  Image<float> high;
};

struct HullBounds {
  DepthBounds possible;  ///< beyond them nothing is
  DepthBounds likely;    ///< within those; counts little, but decides where nothing else does
  double sigma = 0.0;    ///< standard error of all: a voxel
};

/// Divides a surface so that it can lie within the bounds.
/// @param depth     (height, width) ln D of the surface as it is, where `is_known`
/// @param region    (height, width) the division so far, numbered from 0; gets further numbers
/// @return  the number of regions added
[[nodiscard]] int divide_by_hull(const HullBounds& bounds, const Image<float>& depth,
                                 const SurfaceEstimate& surface,
                                 const Image<std::uint8_t>& is_known, Image<int>& region);

/// How far a part may be moved along the view.
struct PartMoves {
  double best =
      0.0;  ///< ln D: added to the part's, it lies within the bounds as well as it can
  double nearest = 0.0;   ///< so far towards the camera it does nearly as well
  double furthest = 0.0;  ///< and away from it
  bool is_known = false;  ///< false: no pixel of it has bounds
};

/// One per part, in the order of `parts`.
[[nodiscard]] std::vector<PartMoves> part_moves(const HullBounds& bounds,
                                                const Image<float>& depth, const Parts& parts);

}  // namespace haarlight::relight
