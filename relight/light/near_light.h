// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "core/rig/camera_model.h"
#include "session/session.h"

/// @file
/// Lights at a finite distance, and where a capture's pixels are under them. Everything in mm
/// in one right-handed frame: a rig's world, or, for an import, the picture's own (x right, y
/// up, z to the camera, origin in the picture's middle on the target). Source: Huang et al.,
/// "Near Light Correction for Image Relighting and 3D Shape Recovery", eq. 2; the lobe: Queau
/// et al., "LED-based Photometric Stereo" (2018).

namespace haarlight {

/// A light with a lobe: as a point it gives the point p with unit normal n the irradiance
/// power * cos^mu(angle to axis) * max(0, n.(l - p)) / |l - p|^3; as a flat rectangle the mean
/// of that over its area.
struct NearLight {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = -Eigen::Vector3d::UnitZ();  ///< unit, the way it shines
  double mu = 0.0;                                   ///< 0: isotropic; 1: a Lambertian emitter
  Eigen::Vector3d power = Eigen::Vector3d::Ones();   ///< R, G, B
  /// Two edges of the rectangle that shines, as columns: mm long, position_mm in its middle.
  /// Zero: a point.
  Eigen::Matrix<double, 3, 2> emitter_mm = Eigen::Matrix<double, 3, 2>::Zero();
  /// Where its axis points to, if it follows the position, as in a dome; nothing: it does not.
  std::optional<Eigen::Vector3d> aim_mm = {};
  /// How far off its aim it points: added to the unit vector towards it.
  Eigen::Vector3d aim_off = Eigen::Vector3d::Zero();
};

/// After position or aim were changed: axis and emitter turned, where there is an aim.
void turn_to_aim(NearLight& light);
/// d axis / d position, mm^-1; zero without an aim.
[[nodiscard]] Eigen::Matrix3d axis_per_position(const NearLight& light);
/// Two unit directions across the way to the aim, in which it may be off.
[[nodiscard]] Eigen::Matrix<double, 3, 2> across_aim(const NearLight& light);
/// d axis / d aim_off along those two; zero without an aim.
[[nodiscard]] Eigen::Matrix<double, 3, 2> axis_per_aim(const NearLight& light);

/// The places that stand for a light's area: its position, or the 2 x 2 points of Gauss and
/// Legendre. They have the rectangle's first three moments along either edge; what is left is
/// of fourth order in edge over distance (measured: docs/numerics/near-light.md).
struct EmitterPoints {
  std::array<Eigen::Vector3d, 4> at;
  int n = 1;
};
[[nodiscard]] EmitterPoints emitter_points(const NearLight& light) noexcept;

/// The irradiance without power, mm^-2; 0 behind the surface or behind the light.
[[nodiscard]] double light_stencil(const NearLight& light, const Eigen::Vector3d& point,
                                   const Eigen::Vector3d& normal) noexcept;

/// The lights of a session.
struct CaptureLights {
  bool are_near = false;
  std::vector<NearLight> near;  ///< (n_lights) where are_near
  /// (n_lights), unit, to the light, seen from the target's middle.
  std::vector<Eigen::Vector3d> directions;
};

/// A rig's elements with lobes and measured powers; an import's, isotropic where no lobe is.
[[nodiscard]] CaptureLights capture_lights(const Session& session);

/// CaptureLights::directions in the picture's frame (x right, y up, z to the camera), which is
/// what pictures that are lit by direction count in; an import's are in it already.
[[nodiscard]] std::vector<Eigen::Vector3d> picture_directions(const Session& session);
/// Of a rig, as its first camera sees it.
[[nodiscard]] std::vector<Eigen::Vector3d> picture_directions(const Rig& rig);

/// A session's lights as its picture sees them: x right, y up, z to the camera; an import's as
/// they are, a rig's from its object_centre with their lobes. Empty of a rig without a camera.
[[nodiscard]] std::vector<SessionLight> lights_in_picture(const Session& session);
/// Of a rig.
/// @param lights  its elements, in order
[[nodiscard]] std::vector<SessionLight> lights_in_picture(const Rig& rig,
                                                          std::vector<SessionLight> lights);

/// Where each pixel sees the target's reference plane, and which way the picture lies.
class PixelPoints {
 public:
  /// Parallel projection: `width_mm` across the picture, the plane z = 0.
  static PixelPoints orthographic(int width, int height, double width_mm);
  /// The same of a picture that was cut out of a larger one, in whose middle the origin is.
  static PixelPoints orthographic(int width, int height, double width_mm,
                                  const FrameCrop& crop);
  /// A camera and a plane n.x + d = 0. @throws Error  the plane is not in front of the camera
  static PixelPoints on_plane(const CameraModel& camera, const Eigen::Vector3d& n, double d);

  /// The point that picture place (x, y) sees, pixel centres at +0.5.
  [[nodiscard]] Eigen::Vector3d at(double x, double y) const;
  /// Unit, from the point to the camera.
  [[nodiscard]] Eigen::Vector3d to_camera(double x, double y) const;
  /// Turns a vector into the picture's frame: x right, y up, z to the camera.
  [[nodiscard]] const Eigen::Matrix3d& picture_from_world() const noexcept { return turn_; }
  /// Nothing for parallel projection.
  [[nodiscard]] const CameraModel* camera() const noexcept {
    return is_camera_ ? &camera_ : nullptr;
  }
  /// Of the reference plane, unit, on the camera's side.
  [[nodiscard]] Eigen::Vector3d plane_normal() const;
  /// A point's height above the reference plane, on the camera's side.
  [[nodiscard]] double height_of(const Eigen::Vector3d& point) const;
  /// Of parallel projection; of a camera its size in the picture's middle, across the view.
  [[nodiscard]] double mm_per_pixel() const;

 private:
  bool is_camera_ = false;
  CameraModel camera_;
  Eigen::Vector3d n_ = Eigen::Vector3d::UnitZ();
  double d_ = 0.0;
  double mm_per_pixel_ = 1.0;
  Eigen::Vector2d middle_ = Eigen::Vector2d::Zero();  ///< pixels; of parallel projection
  Eigen::Matrix3d turn_ = Eigen::Matrix3d::Identity();
};

/// Of a session with a rig: its camera and its first shadow plane (moved up by `height_mm`); of
/// an import: parallel projection over `width_mm`, the origin in the middle of the whole
/// picture where the session holds a part of it.
/// @throws Error  an import without width_mm (> 0)
[[nodiscard]] PixelPoints pixel_points(const Session& session, double width_mm,
                                       double height_mm = 0.0);

}  // namespace haarlight
