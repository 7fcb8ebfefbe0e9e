// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>

#include <Eigen/Core>

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/rays/ray_caster.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A scene under square lights, seen by a camera: direct light only, RGB, with an error
/// estimate. The ground truth against which relighting and reprojected shadows are assessed.

namespace haarlight::render {

struct LitOptions {
  int n_subpixels = 2;  ///< n x n sub-pixel centres per pixel
  DirectLightOptions direct{};
  Eigen::Vector3d background = Eigen::Vector3d::Zero();  ///< radiance where nothing is hit
  ProgressStyle progress = ProgressStyle::none;
};

struct LitPicture {
  Image<float> radiance;  ///< (height, width, 3) linear
  Image<float> error;     ///< (height, width, 3) one standard error of `radiance`
  Image<float> coverage;  ///< (height, width, 1) fraction of sub-pixels that hit something
  double relative_error = 0.0;  ///< ||error||_2 / ||radiance||_2
  std::uint64_t n_rays = 0;
  double seconds = 0.0;
};

/// @param lights   not necessarily the scene's own
/// @param weights  one RGB weight per light: multiplies its radiance
/// Lights of zero weight cost nothing. The result does not depend on the number of threads.
[[nodiscard]] LitPicture render_lit(const Scene& scene, const CameraModel& camera,
                                    std::span<const SquareLight> lights,
                                    std::span<const Eigen::Vector3d> weights,
                                    const LitOptions& options = {});
/// The same with an existing ray caster of the scene.
[[nodiscard]] LitPicture render_lit(const Scene& scene, const RayCaster& caster,
                                    const CameraModel& camera,
                                    std::span<const SquareLight> lights,
                                    std::span<const Eigen::Vector3d> weights,
                                    const LitOptions& options = {});

/// The first surface that the camera sees at picture point (x, y); nothing on the background.
[[nodiscard]] std::optional<SurfacePoint> visible_surface(const RayCaster& caster,
                                                          const CameraModel& camera, double x,
                                                          double y);

}  // namespace haarlight::render
