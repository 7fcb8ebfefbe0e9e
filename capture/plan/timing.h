// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "haarlight/core/rig/rig.h"

/// @file
/// The times of one shot, from the rig file: how long light needs to settle, how long a shot
/// takes. Pure.

namespace haarlight::capture {

/// Added to the measured settle times: jitter of timestamps and of the latch's own clock.
inline constexpr std::int64_t kGuardNs = 100'000;

/// Frames in the dark, before the first light, from which the camera's frame timing is learnt
/// (capture/sequencer/frame_rhythm.h).
inline constexpr std::size_t kFramesToLearn = 8;

/// Bytes a stored frame needs besides its words: TIFF tags, evidence, its part of the journal.
inline constexpr double kFrameOverheadBytes = 4096.0;

/// From the read-back that shows the latch until the light has certainly settled: latch delay,
/// the slower of rise and fall, and the guard.
[[nodiscard]] std::int64_t settle_ns(const ControllerSpec& controller) noexcept;

/// Camera leads: does every light fit into the frames that its step lasts?
///
///     E + skew + settle + guard <= strobe_every / fps
///
/// @return  empty when it does, else the arithmetic with all its numbers, in words
[[nodiscard]] std::string find_strobe_problem(const Rig& rig, double exposure_us);

/// Camera leads: interval between two readings of the step counter, a fifth of a frame.
[[nodiscard]] std::chrono::microseconds step_poll(const Rig& rig) noexcept;

/// Controller leads: from a latch to the pulse on the camera's trigger line: the light settles,
/// and its read-back has certainly arrived.
[[nodiscard]] std::chrono::microseconds trigger_delay(const Rig& rig) noexcept;

/// Frame times from one latch to the next in the rig's sync mode: the mean over the latch's
/// phase in the frame. In free-run: the part of a frame spoilt by the settling light, until the
/// next exposure starts (half a frame on average if phases were random, here at a fixed phase
/// after the frame's arrival), exposure, skew, readout and the latch's round trip.
[[nodiscard]] double expected_frames_a_shot(const Rig& rig, double exposure_us);

/// The same in seconds.
[[nodiscard]] double seconds_a_shot(const Rig& rig, double exposure_us);

}  // namespace haarlight::capture
