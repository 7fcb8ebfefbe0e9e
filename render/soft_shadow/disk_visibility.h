// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"

/// @file
/// Which fraction of a disk light a straight edge leaves visible. Source: [Jakobsen04], section 4,
/// its t derived anew: the printed equation 3 gives t above 1. Light frame: the disk of radius r
/// lies about the origin in the plane z = 0 and emits to +z. Errors of the three forms:
/// docs/numerics/soft-shadow.md. Pure; safe from any thread.

namespace haarlight::render {

/// V of the visible part t of the diameter.
enum class VisibilityForm : std::uint8_t {
  exact,   ///< the circular segment, circular_segment.h
  cubic,   ///< 3 t^2 - 2 t^3, the paper's eq. 4: off by up to 0.0394
  linear,  ///< t, the paper's for occluders without an umbra: off by up to 0.0577
};
inline constexpr auto kVisibilityFormWords =
    std::to_array<std::string_view>({"exact", "cubic", "linear"});
constexpr std::span<const std::string_view> words_of(VisibilityForm) {
  return kVisibilityFormWords;
}

/// Visible fraction of the disk's area, 0..1.
/// @param t  0..1: clamped by the caller. @throws ContractViolation  beyond it, or not a number
[[nodiscard]] double disk_visibility(double t, VisibilityForm form);

/// t at a receiver from which the disk's centre c is hidden, of distances from c along the ray
/// through the receiver:
///
///     t = x_s (x - x_uv) / (2 x_uv (x - x_s))
///
/// Up to x_uv is umbra: 0. Beyond it nothing is clamped: an edge parallel to the light gives
/// [0, 1/2] but for rounding, a tilted one may leave [0, 1] and is infinite for x = x_s.
/// @param x     > 0, finite: the receiver's distance
/// @param x_s   of the plane through the edge, edge_plane_distance() of extrusion.h; infinite: t's
///              limit
/// @param x_uv  > 0: where the ray leaves the umbra; infinite: it never does
/// @throws ContractViolation  a distance that is not one
[[nodiscard]] double t_from_umbra(double x, double x_s, double x_uv);

/// t at a receiver that sees c:
///
///     t = 1 - x_s (x - x_pv) / (2 x_pv (x - x_s))
///
/// Up to x_pv the light is seen whole: 1. Otherwise as t_from_umbra().
/// @param x_pv  > 0: where the ray enters the penumbra; infinite: it never does
[[nodiscard]] double t_from_penumbra(double x, double x_s, double x_pv);

/// The visible part of the diameter across an edge's line on the disk, from t on the diameter
/// through c in the plane of the above: where the line of a tilted edge meets the disk's plane in
/// a, the lines that the edge draws there turn about a.
///
///     A = |a - c|,  q = r A/sqrt(A^2 - r^2),  y0 = q (1 - 2t),  s = (y0/r) A/sqrt(A^2 + y0^2)
///
/// and the result is (1 - s)/2, without cancellation near 0; exactly V's argument.
/// @param t         0..1
/// @param r_over_a  r/A, 0..1; 0: the edge is parallel to the light
[[nodiscard]] double t_of_tilted_edge(double t, double r_over_a);

/// What an edge draws on the disk as seen from a receiver: the line normal.p = offset r. The disk
/// is seen where normal.p > offset r.
struct DiskLine {
  Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  ///< unit
  double offset = 0.0;  ///< signed distance from the centre, of r; +-infinity: no line
};

/// Where the plane through the receiver and an edge meets the disk's plane. Exact at any angle.
/// Relative error of 1 - offset, and so of a small visibility: some roundings of the edge's
/// distance from c, over r (1 - offset).
/// @param x       the receiver, x.z > 0
/// @param v1, v2  the edge, in the order in which it runs round the occluder counter-clockwise as
///                seen from x: the occluder is to its left
/// @param radius  r > 0
/// @return nothing: the receiver lies on the edge's line, or the edge has no length
/// @throws ContractViolation  x or r beyond their range, or not finite
[[nodiscard]] std::optional<DiskLine> line_on_disk(const Eigen::Vector3d& x,
                                                   const Eigen::Vector3d& v1,
                                                   const Eigen::Vector3d& v2, double radius);

/// V = (arccos s - s sqrt(1 - s^2)) / pi with s the line's offset; 0 and 1 beyond the rim.
[[nodiscard]] double line_visibility(const DiskLine& line);

}  // namespace haarlight::render
