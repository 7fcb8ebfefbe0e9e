// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/session/session.h"

/// @file
/// Lights at a finite distance, and the positions of a capture's pixels under them. Everything
/// in mm in one right-handed frame: a rig's world, or, for an import, the picture's own (x
/// right, y up, z to the camera, origin in the picture's middle on the target). Source: Huang
/// et al., "Near Light Correction for Image Relighting and 3D Shape Recovery", eq. 2; the lobe:
/// Queau et al., "LED-based Photometric Stereo" (2018).

namespace haarlight::relight {

/// A light with a lobe: as a point source, its irradiance at the point p with unit normal n is
/// power * cos^mu(angle to axis) * max(0, n.(l - p)) / |l - p|^3; as a flat rectangle, the mean
/// of that over its area.
struct NearLight {
  Eigen::Vector3d position_mm = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = -Eigen::Vector3d::UnitZ();  ///< unit, direction of emission
  double mu = 0.0;                                   ///< 0: isotropic; 1: a Lambertian emitter
  Eigen::Vector3d power = Eigen::Vector3d::Ones();   ///< R, G, B
  /// Two edges of the emitting rectangle, as columns in mm, centred on position_mm. Zero: a
  /// point.
  Eigen::Matrix<double, 3, 2> emitter_mm = Eigen::Matrix<double, 3, 2>::Zero();
  /// Where its axis points, if it follows the position, as in a dome; nothing: it does not.
  std::optional<Eigen::Vector3d> aim_mm = {};
  /// Its aiming error: added to the unit vector towards the aim.
  Eigen::Vector3d aim_off = Eigen::Vector3d::Zero();
};

/// To be called after changing position or aim: turns axis and emitter if there is an aim.
void turn_to_aim(NearLight& light);
/// d axis / d position, mm^-1; zero without an aim.
[[nodiscard]] Eigen::Matrix3d axis_per_position(const NearLight& light);
/// Two unit directions perpendicular to the aim's, for the aiming error.
[[nodiscard]] Eigen::Matrix<double, 3, 2> across_aim(const NearLight& light);
/// d axis / d aim_off along those two; zero without an aim.
[[nodiscard]] Eigen::Matrix<double, 3, 2> axis_per_aim(const NearLight& light);

/// The points that represent a light's area: its position, or 2 x 2 Gauss-Legendre points. They
/// match the rectangle's first three moments along either edge; the error is of fourth order in
/// edge over distance (measured: docs/numerics/near-light.md).
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

/// A rig's elements with lobes and measured powers; an import's lights, isotropic unless they
/// have a lobe.
[[nodiscard]] CaptureLights capture_lights(const session::Session& session);

/// CaptureLights::directions in the picture's frame (x right, y up, z to the camera), as used
/// by pictures relit by direction; an import's are in it already.
[[nodiscard]] std::vector<Eigen::Vector3d> picture_directions(const session::Session& session);
/// The same for a rig, as its first camera sees it.
[[nodiscard]] std::vector<Eigen::Vector3d> picture_directions(const Rig& rig);

/// A session's lights as its picture sees them: x right, y up, z to the camera; an import's as
/// they are, a rig's from its object_centre with their lobes. Empty for a rig without a camera.
[[nodiscard]] std::vector<session::SessionLight> lights_in_picture(
    const session::Session& session);
/// The same for a rig.
/// @param lights  its elements, in order
[[nodiscard]] std::vector<session::SessionLight> lights_in_picture(
    const Rig& rig, std::vector<session::SessionLight> lights);

/// Where each pixel sees the target's reference plane, and the picture's orientation.
class PixelPoints {
 public:
  /// Parallel projection: `width_mm` across the picture, the plane z = 0.
  static PixelPoints orthographic(int width, int height, double width_mm);
  /// The same for a crop of a larger picture, with the origin in the larger one's middle.
  static PixelPoints orthographic(int width, int height, double width_mm,
                                  const session::FrameCrop& crop);
  /// A camera and a plane n.x + d = 0. @throws Error  the plane is not in front of the camera
  static PixelPoints on_plane(const CameraModel& camera, const Eigen::Vector3d& n, double d);

  /// The point seen at picture position (x, y), pixel centres at +0.5.
  [[nodiscard]] Eigen::Vector3d at(double x, double y) const;
  /// Unit, from the point to the camera.
  [[nodiscard]] Eigen::Vector3d to_camera(double x, double y) const;
  /// Turns a vector into the picture's frame: x right, y up, z to the camera.
  [[nodiscard]] const Eigen::Matrix3d& picture_from_world() const noexcept { return turn_; }
  /// Nothing for parallel projection.
  [[nodiscard]] const CameraModel* camera() const noexcept {
    return is_camera_ ? &camera_ : nullptr;
  }
  /// Normal of the reference plane, unit, on the camera's side.
  [[nodiscard]] Eigen::Vector3d plane_normal() const;
  /// A point's height above the reference plane, on the camera's side.
  [[nodiscard]] double height_of(const Eigen::Vector3d& point) const;
  /// Pixel size: of parallel projection; of a camera, in the picture's middle, perpendicular to
  /// the view.
  [[nodiscard]] double mm_per_pixel() const;

 private:
  bool is_camera_ = false;
  CameraModel camera_;
  Eigen::Vector3d n_ = Eigen::Vector3d::UnitZ();
  double d_ = 0.0;
  double mm_per_pixel_ = 1.0;
  Eigen::Vector2d middle_ = Eigen::Vector2d::Zero();  ///< pixels; for parallel projection
  Eigen::Matrix3d turn_ = Eigen::Matrix3d::Identity();
};

/// For a session with a rig: its camera and its first shadow plane (raised by `height_mm`); for
/// an import: parallel projection over `width_mm`, the origin in the middle of the whole
/// picture even if the session holds only part of it.
/// @throws Error  an import without width_mm (> 0)
[[nodiscard]] PixelPoints pixel_points(const session::Session& session, double width_mm,
                                       double height_mm = 0.0);

}  // namespace haarlight::relight
