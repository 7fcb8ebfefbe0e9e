// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/pipeline_settings.h"

#include <utility>

namespace haarlight::relight {

void PipelineNotes::add(NoteKind kind, std::string text) {
  notes_.push_back({kind, std::move(text)});
  if (tell_) {
    tell_(notes_.back());
  }
}

}  // namespace haarlight::relight
