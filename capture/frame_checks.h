#pragma once

#include <cstdint>
#include <string>

#include "core/image.h"
#include "session/evidence.h"
#include "session/session.h"

/// @file
/// What the pixels of a frame say by themselves. Pure.

namespace haarlight {

/// Cheap enough for every frame that a camera delivers: one pass.
struct FrameGlance {
  std::uint64_t hash = 0;  ///< XXH3-64 of the active rows
  bool must_differ =
      false;  ///< some pixel is neither 0 nor at white: its noise is in the words
};
/// @param white  the largest word
[[nodiscard]] FrameGlance glance_at(ImageView<const std::uint16_t> active, std::uint16_t white);

/// Completes the evidence (least, greatest and mean word, saturated and black shares, hash) and
/// judges the pixels.
/// @return  empty when good, else what is wrong: every pixel equal and not clipped (a sensor
/// that
///          delivers no picture)
[[nodiscard]] std::string check_pixels(ImageView<const std::uint16_t> active,
                                       const FrameForm& form, FrameEvidence& evidence);

}  // namespace haarlight
