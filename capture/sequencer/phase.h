// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"

/// @file
/// Where a run is: the words of /v1/state and /metrics (docs/reference/http-api.md), for the
/// daemon and for those who ask it.

namespace haarlight::capture {

enum class Phase {
  boot,
  recover,
  idle,
  preflight,
  running,
  paused,
  suspended,
  aborting,
  finalise,
  done,
  safe_off,
};
inline constexpr auto kPhaseWords = std::to_array<std::string_view>(
    {"boot", "recover", "idle", "preflight", "running", "paused", "suspended", "aborting",
     "finalise", "done", "safe-off"});
constexpr std::span<const std::string_view> words_of(Phase) { return kPhaseWords; }

/// Progress of the current shot while running; checks and commits of earlier shots continue in
/// parallel.
enum class ShotStep { none, light, settle, collect };
inline constexpr auto kShotStepWords =
    std::to_array<std::string_view>({"none", "light", "settle", "collect"});
constexpr std::span<const std::string_view> words_of(ShotStep) { return kShotStepWords; }

}  // namespace haarlight::capture
