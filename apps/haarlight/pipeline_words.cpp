// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/pipeline_words.h"

#include <fmt/format.h>

#include "core/log.h"

namespace haarlight {

namespace {

void print_note(const PipelineNote& note, bool is_quiet) {
  switch (note.kind) {
    case NoteKind::result:
      fmt::print("{}\n", note.text);
      return;
    case NoteKind::note:
      if (!is_quiet) {
        fmt::print(stderr, "note: {}\n", note.text);
      }
      return;
    case NoteKind::caution:
      fmt::print(stderr, "{}\n", note.text);
      return;
    case NoteKind::warning:
      log_warning(note.text);
      return;
  }
}

}  // namespace

PipelineSettings pipeline_settings(const CommonOptions& common) {
  PipelineSettings settings;
  settings.memory_bytes = common.memory_bytes;
  settings.progress = common.progress();
  settings.overwrites = common.force;
  settings.tell = [is_quiet = common.quiet](const PipelineNote& note) {
    print_note(note, is_quiet);
  };
  return settings;
}

}  // namespace haarlight
