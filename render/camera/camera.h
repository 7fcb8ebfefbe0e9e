// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/rays/ray.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A renderer's camera: perspective with distortion, from a pinhole or through a thin lens, or
/// orthographic.

namespace haarlight::render {

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

 private:
  [[nodiscard]] Ray clipped(Ray ray) const;

  CameraModel model_;
  CameraOptics optics_;
};

}  // namespace haarlight::render
