// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/shape/photometric_stereo.h"

/// @file
/// How far each normal lies from what its neighbours say. A pixel on an edge shows several
/// surfaces. Where some of them are shadowed or light each other, no light's residual shows
/// which: one normal explains the mixture. Beside the pixel's neighbours it shows.

namespace haarlight {

/// Adds to every good pixel's standard error, as a square, by how much the angle between its
/// normal and the mean of those of the two pixels on either side of it (rms over row and
/// column) exceeds what the standard error already tells of: d^2 - 1.5 sigma^2, where it is
/// positive. Smooth surfaces give next to nothing: a sphere of r pixels 1 / (2 r^2) radians, r
/// = 50: 0.01 degrees. Pixels of which one neighbour is not known (the mask's rim) count along
/// the other direction, or get nothing. What it is worth: docs/numerics/shape.md.
/// @param surface  with sigma_deg; changed in place
void add_unevenness(SurfaceEstimate& surface);

}  // namespace haarlight
