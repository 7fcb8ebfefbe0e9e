// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/light/near_light.h"
#include "haarlight/relight/shape/pixel_samples.h"

/// @file
/// Which pixels of a capture show the object, detected from the capture itself. Two methods,
/// depending on what is known; each pixel is classified by all its lights, never by one
/// picture. Errors: docs/numerics/shape.md, "The object's mask".

namespace haarlight::relight {

enum class MaskOrigin {
  whole,     ///< no background was found: every pixel counts
  plane,     ///< the background looks like the rig's empty plane
  darkness,  ///< the background is black under every light
};
inline constexpr auto kMaskOriginWords =
    std::to_array<std::string_view>({"whole", "plane", "darkness"});
constexpr std::span<const std::string_view> words_of(MaskOrigin) { return kMaskOriginWords; }

struct ObjectMask {
  Image<std::uint8_t> mask;  ///< (height, width): 1 shows the object
  MaskOrigin origin = MaskOrigin::whole;
  std::int64_t n_object = 0;
};

/// The plane: a pixel is background where, of the lights that reach it, three quarters are as
/// bright as the bare plane would be there, times an albedo that varies over the picture at
/// most as a quadratic; anything darker than a third of that is the object's shadow. Requires 2
/// % of the pixels to show bare plane mostly unshadowed, and 5 % of a pixel's lights
/// unshadowed. A flat, low object of the plane's own albedo looks like the plane and is not
/// found.
/// @param lights  near, in the frame of `plane`
[[nodiscard]] ObjectMask mask_by_plane(const StackSource& stack, const StereoLights& lights,
                                       const PixelPoints& plane);

/// Darkness: background are pixels whose bright level (exceeded by a tenth of the lights) lies
/// below a gap in the picture's levels and that are connected to the picture's border. No such
/// gap: the mask is the whole picture.
[[nodiscard]] ObjectMask mask_by_darkness(const StackSource& stack, const StereoLights& lights);

}  // namespace haarlight::relight
