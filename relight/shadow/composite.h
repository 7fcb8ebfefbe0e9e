// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>

#include "core/image.h"
#include "core/rig/camera_model.h"
#include "core/tolerance.h"
#include "relight/shadow/area_mean.h"
#include "relight/shadow/plane_frame.h"
#include "render/ray_caster.h"

/// @file
/// The object's own relit picture in the synthetic scene. What the camera captured is the
/// object seen from one place: the scene is drawn from the same camera, and the object laid
/// over it where the capture shows no plane.

namespace haarlight {

struct CompositeOptions {
  /// Where the object can be, over the plane: scene surfaces nearer to the camera than its
  /// top hide it. Unknown: the object is over everything.
  std::optional<HeightRange> object;
  double scale = 1.0;  ///< from the capture's values to the scene's radiance
};

struct CompositeCount {
  std::int64_t n_object = 0;  ///< pixels that show the object
  std::int64_t n_hidden = 0;  ///< pixels of it behind the scene
  Image<std::uint8_t> drawn;  ///< (h, w, 1) 1 where the object was drawn
};

/// What brings a capture's values to the radiance of a scene whose lights have radiance 1 at
/// drive 1. On the plane T = g B, with B as RigPlate has it, so a plane of albedo rho has
/// T rho A/(pi 1e6 g) of radiance.
/// @param plate_scale  g, for the sum of `channels` colours
/// @param area_mm2     of one LED
[[nodiscard]] double scene_scale(double plate_scale, int channels, double albedo,
                                 double area_mm2);

/// @param picture  (h, w, 3) of the scene, drawn over in place
/// @param object   (h, w, 1 or 3) relit
/// @param shows_object  (h, w, 1) 1 where the camera sees the object
CompositeCount draw_object(Image<float>& picture, const Image<float>& object,
                           const Image<std::uint8_t>& shows_object, const RayCaster& scene,
                           const CameraModel& camera, const PlaneFrame& frame,
                           const CompositeOptions& options);

/// How far the drawn object's own pixels are from the truth's.
/// @param picture, truth  (h, w, 3)
/// @param drawn           (h, w, 1) as CompositeCount has it
[[nodiscard]] Achieved compare_drawn(const Image<float>& picture, const Image<float>& truth,
                                     const Image<std::uint8_t>& drawn);

}  // namespace haarlight
