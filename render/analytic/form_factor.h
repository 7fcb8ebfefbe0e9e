// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// Form factors in closed form [Howell10]: the fraction of the light of one Lambertian surface that
/// arrives at another. Lengths in one unit, above 0. To 1e-10 relative where they are alike, to 1e-6
/// where their ratios reach 10^6. Pure.

namespace haarlight::render {

/// From one of two a x b rectangles to the other, parallel and opposite each other.
[[nodiscard]] double form_factor_parallel(double a, double b, double gap);

/// From a rectangle `from` deep to one `to` high that stands on their common edge.
[[nodiscard]] double form_factor_perpendicular(double edge, double from, double to);

/// From a disk of radius r1 to one of radius r2 on the same axis.
[[nodiscard]] double form_factor_coaxial_disks(double r1, double r2, double gap);

}  // namespace haarlight::render
