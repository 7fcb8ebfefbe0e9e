// SPDX-License-Identifier: Apache-2.0
#include "apps/haarlight/options/pipeline_words.h"

#include <fmt/format.h>

#include "core/log.h"

namespace haarlight::apps {

namespace {

void print_note(const relight::PipelineNote& note, bool is_quiet) {
  switch (note.kind) {
    case relight::NoteKind::result:
      fmt::print("{}\n", note.text);
      return;
    case relight::NoteKind::note:
      if (!is_quiet) {
        fmt::print(stderr, "note: {}\n", note.text);
      }
      return;
    case relight::NoteKind::caution:
      fmt::print(stderr, "{}\n", note.text);
      return;
    case relight::NoteKind::warning:
      log_warning(note.text);
      return;
    case relight::NoteKind::failure:
      log_error(note.text);
      return;
  }
}

}  // namespace

relight::PipelineSettings pipeline_settings(const CommonOptions& common) {
  relight::PipelineSettings settings;
  settings.memory_bytes = common.memory_bytes;
  settings.progress = common.progress();
  settings.overwrites = common.force;
  settings.tell = [is_quiet = common.quiet](const relight::PipelineNote& note) {
    print_note(note, is_quiet);
  };
  return settings;
}

}  // namespace haarlight::apps
