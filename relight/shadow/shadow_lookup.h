// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <span>

#include <Eigen/Core>

#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/relight/shadow/visibility.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// How much of a light a point sees past the object, looked up in the shadow pictures of one or
/// several planes: step_to_plane (projection.h) and project_window (area_mean.h) in the plane
/// picture's own coordinates, where eq. (4) holds for columns and rows as for millimetres.
/// Pure; safe from any thread.

namespace haarlight::relight {

/// Plane picture of light k's visibility; called from one thread.
using VisibilitySource = std::function<Visibility(int k)>;

/// A plane that the object's shadow was captured on.
struct SamplingPlane {
  PlaneFrame frame;
  VisibilitySource visibility;
  std::optional<HeightRange> object;  ///< over this plane
  /// How finely the pictures were seen, mm on the plane: the larger of texel and camera pixel.
  double resolution_mm = 0.0;
  /// What making one picture costs, in look-ups of it; 0: it lies ready. Blocks of lights whose
  /// pictures would be made twice are not tried where that costs a tenth of the exact sums.
  double picture_lookups = 0.0;
};

/// A world point relative to a plane.
struct PlaneSpot {
  double height = 0.0;  ///< mm over the plane
  double x = 0.0;       ///< picture coordinates of its perpendicular foot
  double y = 0.0;
};
[[nodiscard]] PlaneSpot locate_point(const PlaneFrame& frame, const Eigen::Vector3d& world);

/// A light, or a block of lights taken as one, relative to a plane.
struct PlaneLight {
  PlaneSpot centre;
  std::array<PlaneSpot, 4> corners;
  bool is_upright = false;  ///< parallel to the plane, sides along the picture's
  double half_x = 0.0;      ///< half its width in picture pixels, when upright
  double half_y = 0.0;
};
[[nodiscard]] PlaneLight place_light(const PlaneFrame& frame, const render::SquareLight& light);

/// Where the vertex is, relative to the plane.
enum class PlaneSide {
  no_point,  ///< the ray does not meet the plane
  on,        ///< within a hundredth of a texel of it
  above,     ///< on the light's side
  below,
};

struct ShadowLook {
  PlaneSide side = PlaneSide::no_point;
  double value = 1.0;  ///< the middle of its bounds; an occluder's own
  double lower = 0.0;  ///< distance to the lower bound, of what is unknown and of the heights
  double upper = 0.0;  ///< to the upper one
  double deviation = 0.0;  ///< of what was measured and not settled as lit
  double moved = 0.0;      ///< of `value`: what an occluder took out of it as noise
  double unknown = 0.0;    ///< fraction of the window
  double outside = 0.0;    ///< fraction of the window beyond the plane picture, taken as lit
  double from_occluder = 0.0;  ///< fraction that an occluder told, not the picture
  double step = 0.0;  ///< from the vertex to the plane, in units of the distance between light
                      ///< and vertex; < 0 towards the light
  double widening = 1.0;  ///< penumbra above the plane: largest factor too wide
};

/// What all look-ups of a job have in common.
struct LookRule {
  WindowRule window = WindowRule::corrected;
  /// The light is a block of lights: it has a window even where the rule gives a single light
  /// none, so that no member's shadow falls between its look-ups.
  bool is_block = false;
};

[[nodiscard]] ShadowLook look_up(const PlaneFrame& frame,
                                 const std::optional<HeightRange>& object, LookRule rule,
                                 const PlaneLight& light, const WindowSums& sums,
                                 const PlaneSpot& vertex);

/// Combines several planes' answers: interpolates between the nearest plane on each side of the
/// vertex by distance along the ray; with planes on one side only, takes the nearest. Planes
/// whose picture the ray misses are left out.
[[nodiscard]] ShadowLook combine(std::span<const ShadowLook> looks);

/// True if no window of any light within the block can contain a shadow: everything they could
/// touch is within the picture and lit. Blocks that are not upright: false.
/// @param centres  the outermost lights' centres as if they were the block's corners
/// @param light    one of its lights
[[nodiscard]] bool is_all_lit(const PlaneFrame& frame, const std::optional<HeightRange>& object,
                              WindowRule rule, const PlaneLight& centres,
                              const PlaneLight& light, const WindowSums& sums,
                              const PlaneSpot& vertex);

}  // namespace haarlight::relight
