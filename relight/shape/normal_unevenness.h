// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/relight/shape/photometric_stereo.h"

/// @file
/// How far each normal deviates from its neighbours. A pixel on an edge shows several surfaces.
/// Where some of them are shadowed or light each other, no light's residual reveals it: one
/// normal explains the mixture. A comparison with the pixel's neighbours does.

namespace haarlight::relight {

/// Adds to every good pixel's standard error, as a square, by how much the angle between its
/// normal and the mean of those of the two pixels on either side of it (rms over row and
/// column) exceeds what the standard error already explains: d^2 - 1.5 sigma^2, if positive.
/// Smooth surfaces add next to nothing: a sphere of r pixels 1 / (2 r^2) radians, r = 50: 0.01
/// degrees. Pixels with an unknown neighbour (the mask's rim) use only the other direction, or
/// add nothing. Benefit: docs/numerics/shape.md.
/// @param surface  with sigma_deg; changed in place
void add_unevenness(SurfaceEstimate& surface);

}  // namespace haarlight::relight
