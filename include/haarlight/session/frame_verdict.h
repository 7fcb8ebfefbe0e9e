// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

/// @file
/// What is wrong with a frame's picture, whatever its light. The sequencer retakes a shot for
/// it, the evidence stores it.

namespace haarlight {

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

[[nodiscard]] std::string_view to_string(FrameVerdict verdict) noexcept;
/// The names of all verdicts, in the enumerators' order.
[[nodiscard]] const std::vector<std::string_view>& frame_verdict_words();

}  // namespace haarlight
