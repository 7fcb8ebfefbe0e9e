// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"

/// @file
/// What a line of a session's journal is about: its column `kind`, and the name of the daemon's
/// event (docs/reference/session-format.md, docs/reference/http-api.md).

namespace haarlight::session {

enum class EventKind {
  // of the session's writer
  adopted,       ///< a good frame without a row got one
  returned,      ///< recovery found a committed frame missing or altered
  set_aside,     ///< a file was moved to aside/
  refused,       ///< a frame that the checks refused was kept in aside/
  withdrawn,     ///< a committed frame is taken again
  rebuilt,       ///< the journal was made again from the frames
  not_reserved,  ///< the file system cannot reserve space
  finished,      ///< the last event of a finished session
  // of the daemon
  state,
  fault,
  retry,
  light,
  controller,
  camera,
  dark,
  committed,
};
inline constexpr auto kEventKindWords = std::to_array<std::string_view>(
    {"adopted", "returned", "set_aside", "refused", "withdrawn", "rebuilt", "not_reserved",
     "finished", "state", "fault", "retry", "light", "controller", "camera", "dark",
     "committed"});
constexpr std::span<const std::string_view> words_of(EventKind) { return kEventKindWords; }

}  // namespace haarlight::session
