// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/session/frame_verdict.h"

/// @file
/// What is stored with every frame so that anyone can verify, years later, that it saw its
/// light and no other. Times are CLOCK_MONOTONIC nanoseconds of the capturing machine.

namespace haarlight::session {

/// How the evidence came to be: measured by the daemon, asserted by an import, or replayed.
enum class EvidenceKind { measured, asserted, replayed };
inline constexpr auto kEvidenceKindWords =
    std::to_array<std::string_view>({"measured", "asserted", "replayed"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(EvidenceKind) noexcept {
  return kEvidenceKindWords;
}

struct FrameEvidence {  // NOLINT(clang-analyzer-optin.performance.Padding): sorted for readers
  EvidenceKind kind = EvidenceKind::measured;
  std::int64_t pattern_id = -1;  ///< the shot's pattern in the plan
  std::uint32_t tag = 0;         ///< tag written with the pattern
  std::uint32_t tag_echo = 0;    ///< tag returned by the controller after the latch
  /// The controller has no tags (a profile's): every channel was read back and held what was
  /// written, and tag_echo is the host's own.
  bool is_read_back = false;
  std::int64_t t_command_ns = 0;  ///< the latch was sent
  std::int64_t t_ack_ns = 0;      ///< its acknowledgement arrived
  /// When the answer arrived that shows tag and sum (camera leads: the first reading of the
  /// step before the exposure). Nothing: a session from before this was stored, or no reading
  /// fell there.
  std::optional<std::int64_t> t_shown_ns;
  std::int64_t t_stable_ns = 0;          ///< t_shown + settle + guard
  std::int64_t t_exposure_start_ns = 0;  ///< first row's exposure start, from the timestamp
  std::int64_t t_exposure_end_ns = 0;    ///< last row's exposure end
  std::int64_t t_next_change_ns = 0;     ///< the next command to the lights
  std::uint64_t sequence = 0;            ///< the camera's frame number
  std::int64_t timestamp_ns = 0;         ///< the camera's timestamp
  std::uint32_t flags = 0;               ///< FrameFlag bits, see capture/camera/camera.h
  double exposure_requested_us = 0.0;
  double exposure_read_us = 0.0;
  double gain_db = 0.0;
  double read_us = 0.0;  ///< the rig's value used in the rule
  double skew_us = 0.0;
  TimestampMeaning timestamp_meaning = TimestampMeaning::end_frame;  ///< used in the rule
  std::int64_t step_before = -1;  ///< camera leads: the table's step counter before the frame
  std::int64_t step_after = -1;   ///< and after it; -1 in the other modes
  double margin_us = 0.0;         ///< smallest distance of the exposure to a light change
  int discarded_before = 0;       ///< frames dropped since the latch
  SyncMode sync = SyncMode::free_run;
  std::uint16_t min_dn = 0;
  std::uint16_t max_dn = 0;
  double mean_dn = 0.0;
  double saturated_fraction = 0.0;  ///< fraction of active pixels at or above the clip level
  double black_fraction = 0.0;      ///< fraction of active pixels at or below the black level
  std::string pixel_hash;           ///< content_hash of the active pixels' bytes
  /// Not good in a committed frame: it was retaken as often as the plan allows without success.
  FrameVerdict verdict = FrameVerdict::good;
  std::optional<double> temperature_c;  ///< the controller's, read after the exposure
  /// Another frame of the same lights, which followed a different light, shows the same picture
  /// (docs/numerics/light-proof.md). False: no such proof, which is not a disproof.
  bool is_picture_proved = false;
  // Distances in sigma; nothing: there was no prediction.
  std::optional<double> picture_own_sigma;             ///< to its own prediction
  std::optional<double> picture_other_sigma;           ///< to the nearest other one
  std::optional<double> picture_discrimination_sigma;  ///< between the two
  int picture_other = -1;  ///< a shot of that other pattern; -1: none
  /// An earlier shot of the same lights, which followed a different light and has the same
  /// picture; -1: none.
  int agrees_with = -1;
  /// Upper bound of the fraction of this frame's light, and of that one's, that came from the
  /// light before, 0 .. 1 at 5 sigma; nothing: agrees_with is -1.
  std::optional<double> other_light_at_most;
  /// Where the plan requires frames to agree: the means of 8 x 8 blocks, row by row, less dark,
  /// in counts per microsecond at 0 dB; -1e9: clipped. Otherwise empty.
  std::vector<double> picture_points;

  friend bool operator==(const FrameEvidence&, const FrameEvidence&) = default;
};

/// Evidence as one line of JSON and back (used by the TIFF's ImageDescription and
/// session.json). Times are whole nanoseconds; numbers keep every bit. @throws
/// ContractViolation on NaN
[[nodiscard]] std::string evidence_to_json(const FrameEvidence& evidence);
/// @throws Error  naming the missing or wrong field, prefixed by `where`
[[nodiscard]] FrameEvidence evidence_from_json(const std::string& json,
                                               const std::string& where);

}  // namespace haarlight::session
