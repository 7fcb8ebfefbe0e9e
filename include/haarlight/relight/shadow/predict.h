// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// The design tool's formulas: how finely an array samples shadows and the resulting error,
/// from lengths alone [Kim13, eq. (1)] and docs/numerics/shadow.md. Lengths in mm; H is the
/// light's height over the plane, h an edge's height, s the light's side, d_l the lights'
/// spacing. Pure.

namespace haarlight::relight {

/// d_s = d_l h_s/h_l: distance between the shadows of one edge under neighbouring lights, with
/// h_s = h and h_l = H - h.
/// @throws ContractViolation  unless 0 <= h < H (the same below)
[[nodiscard]] double shadow_spacing(double light_spacing, double h, double H);

/// B = s h/(H - h): width of an edge's penumbra on the plane.
[[nodiscard]] double penumbra_width(double side, double h, double H);

/// s (h - h_v)/(H - h): on a receiver at height h_v, below or above the plane; 0 beyond the
/// edge.
[[nodiscard]] double penumbra_width_at(double side, double h, double H, double h_receiver);

/// Relative ripple of a strip's shadow, o wide at height h, under all lights at full power: the
/// cost of gaps between lights. ((d_l - s)/s) d_l h/(o H).
[[nodiscard]] double gap_ripple(double side, double light_spacing, double strip, double h,
                                double H);

/// Integrated squared error, mm per mm of edge, when a hard sun of size a (its penumbra's width
/// on the plane) is drawn by a light of penumbra W: (W - a)^2/(12 W), for a <= W.
[[nodiscard]] double hard_sun_error(double window, double sun);

/// The same for a light half a spacing off the grid, drawn by its two neighbours: penumbra W,
/// shadows D apart. 0.048 D for the 28 mm LEDs 30 mm apart of the paper, D/24 without a gap.
[[nodiscard]] double off_grid_error(double window, double spacing);

/// The largest camera pixel on the plane that still resolves the penumbra: W/2.
[[nodiscard]] double largest_pixel(double window);

}  // namespace haarlight::relight
