// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include <Eigen/Core>
#include <tl/expected.hpp>

#include "haarlight/core/enum_words.h"

/// @file
/// Silhouettes of an occluder as seen from a whole disk light, and the planes through their edges
/// that touch the disk: the sides of its umbra and penumbra. Source: [Jakobsen04], section 2.1.
/// Light frame: the disk of radius r lies about the origin in the plane z = 0 and emits to +z.
/// Pure; safe from any thread.

namespace haarlight::render {

/// Which of the disk's points are in front of a face's plane.
enum class FaceClass : std::uint8_t { none_front_facing, silhouette, all_front_facing };
inline constexpr auto kFaceClassWords =
    std::to_array<std::string_view>({"none-front-facing", "silhouette", "all-front-facing"});
constexpr std::span<const std::string_view> words_of(FaceClass) { return kFaceClassWords; }

/// Of a face through `point`: by the disk's points of greatest and of least signed distance to its
/// plane (eq. 1a, 1b). A plane that only touches the rim has no silhouette face.
/// @param normal  m, outward, of any length but 0. @throws ContractViolation  0 or not finite
[[nodiscard]] FaceClass face_class(const Eigen::Vector3d& normal, const Eigen::Vector3d& point,
                                   double radius);

/// Whether an edge between faces of these classes is on the silhouette of the umbra.
[[nodiscard]] constexpr bool is_umbra_edge(FaceClass left, FaceClass right) {
  return (left == FaceClass::none_front_facing) != (right == FaceClass::none_front_facing);
}
/// The same for the penumbra.
[[nodiscard]] constexpr bool is_penumbra_edge(FaceClass left, FaceClass right) {
  return (left == FaceClass::all_front_facing) != (right == FaceClass::all_front_facing);
}

/// Where the line of an edge meets the disk's plane: the homogeneous point a = (X, Y, w), at
/// (X, Y)/w. w = 0: the edge is parallel to the disk, (X, Y) its direction.
[[nodiscard]] Eigen::Vector3d point_in_disk_plane(const Eigen::Vector3d& v1,
                                                  const Eigen::Vector3d& v2);

/// Why an edge has no extrusion points.
enum class ExtrusionFault : std::uint8_t {
  no_length,   ///< its ends are one point
  meets_disk,  ///< its line goes through the disk: D < r (1 - 1e-12)
  no_side,     ///< the occluder's point lies between the two planes or opposite
};
inline constexpr auto kExtrusionFaultWords = std::to_array<std::string_view>(
    {"the edge has no length",
     "the edge's line meets the disk: no silhouette edge of a closed two-manifold does",
     "the occluder's point is on no side of the planes through the edge that touch the disk"});
constexpr std::span<const std::string_view> words_of(ExtrusionFault) {
  return kExtrusionFaultWords;
}

/// Points of the rim, in the plane z = 0.
struct Extrusion {
  Eigen::Vector2d umbra;     ///< p_u: its plane has disk and occluder on one side
  Eigen::Vector2d penumbra;  ///< p_p: its plane parts them
};

/// The points where the planes through an edge touch the rim. With a = (X, Y, w), h = |(X, Y)| and
/// D = h/|w| the distance of a from the centre,
///
///     p = r (cos phi u +- sin phi u_perp),   u = (X, Y)/h,   cos phi = r w/h:
///
/// smooth where the edge turns parallel to the disk, w -> 0. D within r (1 +- 1e-12): both are a.
/// Absolute error: some roundings of r, and their square root where D is near r.
/// @param v1, v2    the edge; z >= 0, not both 0
/// @param occluder  a point of the occluder off the edge, on a face that is all-front-facing (for
///                  the penumbra) or none-front-facing (for the umbra)
/// @throws ContractViolation  positions not finite, radius not above 0, an edge not in front
[[nodiscard]] tl::expected<Extrusion, ExtrusionFault> extrusion_points(
    const Eigen::Vector3d& v1, const Eigen::Vector3d& v2, const Eigen::Vector3d& occluder,
    double radius);

/// The plane that touches the rim in `rim_point` and goes through `v`, as the normal of
/// normal.p = r; the disk is where normal.p <= r. A ray from the centre along the unit direction d
/// meets it at the distance r/(normal.d) if that is positive, never otherwise: x_uv, x_pv.
/// @param rim_point  |rim_point| = r. @param v  v.z > 0
[[nodiscard]] Eigen::Vector3d touching_plane(const Eigen::Vector2d& rim_point,
                                             const Eigen::Vector3d& v);

/// x_s: how far from the centre a ray meets the plane that is spanned by the edge and
/// n x (a - c), parallel to the disk if the edge is. Infinity: not in front of the centre.
/// @param direction  unit. @param v1, v2  an edge whose line misses the centre
/// @throws ContractViolation  an edge without length or through the centre
[[nodiscard]] double edge_plane_distance(const Eigen::Vector3d& direction,
                                         const Eigen::Vector3d& v1, const Eigen::Vector3d& v2);

/// x_s by the paper, which takes a plane parallel to the disk whatever the edge:
///
///     x_s = (dir(c,e).n / dir(c,x).n) |e - c|,   e the edge's point nearest to the ray   (eq. 2)
///
/// The same for an edge parallel to the disk. Infinity: the ray does not go to the front.
/// @param direction  unit
[[nodiscard]] double paper_edge_distance(const Eigen::Vector3d& direction,
                                         const Eigen::Vector3d& v1, const Eigen::Vector3d& v2);

}  // namespace haarlight::render
