// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/rays/ray.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A renderer's camera: perspective with distortion, from a pinhole or through a thin lens, or
/// orthographic.

namespace haarlight::render {

/// How a camera sees a point in the scene through a point of its lens.
struct CameraSight {
  Eigen::Vector2d at = Eigen::Vector2d::Zero();  ///< of the picture, pixels
  Ray ray;                     ///< from the lens, of unit direction; it ends at the point
  double distance_mm = 0.0;    ///< from the lens
  double pixels_per_sr = 0.0;  ///< Camera::pixels_per_sr() of that ray
};

class Camera {
 public:
  Camera(CameraModel model,
         const CameraOptics& optics = {});  // NOLINT(google-explicit-constructor)

  [[nodiscard]] int width() const noexcept { return model_.width; }
  [[nodiscard]] int height() const noexcept { return model_.height; }
  /// The direction of its axis, unit, world.
  [[nodiscard]] Eigen::Vector3d axis() const { return model_.world_from_cam.linear().col(2); }
  /// Whether ray() looks at `lens`.
  [[nodiscard]] bool has_lens() const noexcept { return optics_.lens_radius_mm > 0.0; }

  /// Through a picture point, of unit direction. A thin lens: all rays of a picture point meet
  /// where the pinhole's ray cuts the plane in focus; they start uniformly over the aperture.
  /// From optics.near_mm to far_mm along the axis, in single precision where it is traced.
  /// @param x, y  pixels, pixel centres at +0.5 @param lens  in [0, 1)^2
  [[nodiscard]] Ray ray(double x, double y, const Eigen::Vector2d& lens) const;

  /// Whether sees() finds anything. Not an orthographic camera's: its rays have one direction, in
  /// which no path arrives by chance.
  [[nodiscard]] bool can_be_reached() const noexcept { return !(optics_.pixel_mm > 0.0); }

  /// The area of the picture over the solid angle of the rays that belong to it, all through one
  /// point of the lens: the importance of that direction, its cosine included, where all points of
  /// the picture count alike ([Veach97], section 8.3). 0 of a ray that sees() cannot find again: of
  /// an orthographic camera, and where the model of the distortion folds back.
  /// @param ray  of ray(x, y, any lens point)
  [[nodiscard]] double pixels_per_sr(const Ray& ray, double x, double y) const;

  /// Where a point is seen by the rays that start at `lens`, whatever lies between; nothing where
  /// it is not, within the picture or beyond its borders.
  [[nodiscard]] std::optional<CameraSight> sees(const Eigen::Vector3d& point,
                                                const Eigen::Vector2d& lens) const;

 private:
  void clip(Ray& ray) const;
  [[nodiscard]] Eigen::Vector3d lens_point(const Eigen::Vector2d& lens) const;

  CameraModel model_;
  CameraOptics optics_;
};

}  // namespace haarlight::render
