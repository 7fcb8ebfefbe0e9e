// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/relight/shadow/visibility.h"

/// @file
/// Several cameras' shadow pictures of one plane: what the object hides from one of them another
/// may see.

namespace haarlight::relight {

enum class PlaneRelation {
  apart,       ///< another plane, or another part of this one
  same,        ///< its picture lies within this one's
  reaches_out  ///< part of its picture lies within this one's, part beyond
};

/// How another plane's picture lies to this one's. One plane: its picture's corners are within a
/// quarter of a texel of this plane, which moves no shadow by more than that under lights less
/// than 45 degrees from the normal. Within: by up to one texel beyond the border.
[[nodiscard]] PlaneRelation relate_planes(const PlaneFrame& frame, const PlaneFrame& other);

/// One picture of what any of the views knows: where several do, the mean by their weights.
/// @param views    all of one light and one frame; at least one
/// @param weights  one per view, over 0: camera pixels per plane pixel, the inverse of a noise
///                 variance, and the finer view counts more
[[nodiscard]] Visibility join_views(std::span<const Visibility> views,
                                    std::span<const double> weights);

}  // namespace haarlight::relight
