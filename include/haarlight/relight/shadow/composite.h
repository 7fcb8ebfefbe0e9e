// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "haarlight/core/image.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/shadow/area_mean.h"
#include "haarlight/relight/shadow/plane_frame.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/rays/ray_caster.h"

/// @file
/// The object's own relit picture in the synthetic scene. The camera captured the object from
/// one viewpoint: the scene is rendered with the same camera, and the object composited over it
/// where the capture does not show the plane.

namespace haarlight::relight {

struct CompositeOptions {
  /// The object's height range over the plane: scene surfaces closer to the camera than its top
  /// hide it. Unknown: the object is in front of everything.
  std::optional<HeightRange> object;
  double scale = 1.0;  ///< from the capture's values to the scene's radiance
};

struct CompositeCount {
  std::int64_t n_object = 0;  ///< pixels that show the object
  std::int64_t n_hidden = 0;  ///< pixels of it behind the scene
  Image<std::uint8_t> drawn;  ///< (h, w, 1) 1 where the object was drawn
};

/// The factor from a capture's values to the radiance of a scene whose lights have radiance 1
/// at weight 1. On the plane the light transport matrix is T = g B, with the clean plate B as
/// in RigPlate, so a plane of albedo rho has radiance T rho A/(pi 1e6 g).
/// @param plate_scale  g, for the sum of `channels` colours
/// @param area_mm2     of one LED
[[nodiscard]] double scene_scale(double plate_scale, int channels, double albedo,
                                 double area_mm2);

/// @param picture  (h, w, 3) of the scene, composited in place
/// @param object   (h, w, 1 or 3) relit
/// @param shows_object  (h, w, 1) 1 where the camera sees the object
CompositeCount draw_object(Image<float>& picture, const Image<float>& object,
                           const Image<std::uint8_t>& shows_object,
                           const render::RayCaster& scene, const CameraModel& camera,
                           const PlaneFrame& frame, const CompositeOptions& options);

/// Adds the environment where the camera looks past the scene: the mean radiance over a disc of
/// directions around the ray, in the environment's unit, in which light weights of
/// rig_weights() light a scene.
/// @param blur_deg  radius of the disc, 0 to 45: a background out of focus; 0: sharp, the
///                  radiance along the ray, whose texels may be larger than pixels
/// @param picture  (h, w, 3) of the scene, black where the camera looks past it
/// @param drawn    (h, w, 1) 1 where something else was drawn over it; empty: nowhere
/// @param n_subpixels  n x n samples per pixel, as of the scene
/// @return         the fraction of the picture that shows the environment
double draw_background(Image<float>& picture, const render::Environment& environment,
                       const render::RayCaster& scene, const CameraModel& camera,
                       const Image<std::uint8_t>& drawn, int n_subpixels, double blur_deg);

/// The error of the drawn object's own pixels against the truth.
/// @param picture, truth  (h, w, 3)
/// @param drawn           (h, w, 1) as in CompositeCount
[[nodiscard]] Achieved compare_drawn(const Image<float>& picture, const Image<float>& truth,
                                     const Image<std::uint8_t>& drawn);

}  // namespace haarlight::relight
