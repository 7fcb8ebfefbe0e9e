// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <span>
#include <string_view>

/// @file
/// What is wrong with a frame's picture, whatever its light. The sequencer retakes a shot for
/// it, the evidence stores it.

#include "haarlight/core/enum_words.h"

namespace haarlight::session {

enum class FrameVerdict : std::uint8_t {
  good,
  no_picture,   ///< every pixel the same word, not clipped: the sensor delivers nothing
  saturated,    ///< more clipped pixels than the plan allows in its shortest exposure
  too_dark,     ///< less light than the plan requires in its longest exposure
  wrong_level,  ///< not the level that another exposure of the same pattern predicts
  stale,        ///< a new frame number with the pixels of an earlier frame
  duplicate,    ///< the same frame delivered twice
  wrong_light,  ///< the picture of another pattern, or a mixture with the previous one
};
inline constexpr auto kFrameVerdictWords =
    std::to_array<std::string_view>({"good", "no_picture", "saturated", "too_dark",
                                     "wrong_level", "stale", "duplicate", "wrong_light"});
constexpr std::span<const std::string_view> words_of(FrameVerdict) {
  return kFrameVerdictWords;
}

/// The names of all verdicts, in the enumerators' order.

}  // namespace haarlight::session
