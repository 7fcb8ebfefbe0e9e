// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <utility>

#include "relight/pipeline/pipeline_settings.h"

/// @file
/// Results that are several lines of text.

namespace haarlight::relight {

/// Reports whole lines as one result; nothing if there are none.
inline void tell_lines(std::string lines, PipelineNotes& notes) {
  if (!lines.empty()) {
    lines.pop_back();  // a note has no trailing line break
    notes.add(NoteKind::result, std::move(lines));
  }
}

}  // namespace haarlight::relight
