// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/session/session.h"

/// @file
/// Pixels that do not measure light: hot in the dark frames, or dead in the flat field. They
/// are detected, counted, and replaced by the median of their good neighbours of the same
/// colour.

namespace haarlight::session {

struct BadPixelMap {
  std::vector<bool> is_bad;  ///< per pixel, row by row; empty: none
  int n_hot = 0;
  int n_dead = 0;
  [[nodiscard]] bool is_empty() const { return is_bad.empty(); }
};

/// Marks the pixels of a dark picture (steps above black) that exceed its median by 8 robust
/// sigmas and by 1 % of the range.
void mark_hot(const Image<float>& dark, double range, BadPixelMap& map);

/// @throws Error  more than 5 % are bad
void require_few_bad(const Session& session, const BadPixelMap& map);

/// Replaces bad pixels of rows [y0, y0 + rows.height()) of the picture. A replaced value's
/// variance is the spread of the neighbours it was computed from; a neighbour that is a lower
/// bound makes it one.
/// @param variance  of the rows, -1 for a lower bound
void inpaint(const FrameForm& form, const BadPixelMap& map, int y0, Image<float>& rows,
             Image<float>& variance);

}  // namespace haarlight::session
