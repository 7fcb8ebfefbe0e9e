// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>

#include "core/image.h"
#include "core/stack/stack_source.h"
#include "relight/light/near_light.h"
#include "relight/shape/pixel_samples.h"

/// @file
/// Which pixels of a capture show the object, found from the capture. Two ways, by what is
/// known; each pixel's own lights decide, never one picture. Errors: docs/numerics/shape.md,
/// "The object's mask".

namespace haarlight {

enum class MaskOrigin {
  whole,     ///< no background was found: every pixel counts
  plane,     ///< the background shows what the rig's empty plane would
  darkness,  ///< the background is black under every light
};
[[nodiscard]] std::string_view to_string(MaskOrigin origin) noexcept;

struct ObjectMask {
  Image<std::uint8_t> mask;  ///< (height, width): 1 shows the object
  MaskOrigin origin = MaskOrigin::whole;
  std::int64_t n_object = 0;
};

/// The plane: a pixel is background where, of the lights that reach it, three quarters are as
/// bright as the bare plane would be there, times an albedo that varies over the picture at
/// most as a quadratic; what is darker than a third of that is the object's shadow. It needs 2
/// % of the pixels to show bare plane mostly unshadowed, and 5 % of a pixel's lights
/// unshadowed. An object that lies flat, low and of the plane's own albedo looks like the
/// plane, and is not found.
/// @param lights  near, in the frame of `plane`
[[nodiscard]] ObjectMask mask_by_plane(const StackSource& stack, const StereoLights& lights,
                                       const PixelPoints& plane);

/// Darkness: pixels whose bright level (which a tenth of the lights exceed) lies below a gap of
/// the picture's levels, and that are joined to the picture's border. No such gap: every pixel.
[[nodiscard]] ObjectMask mask_by_darkness(const StackSource& stack, const StereoLights& lights);

}  // namespace haarlight
