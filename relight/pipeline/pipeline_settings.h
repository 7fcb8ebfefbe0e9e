// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "haarlight/core/progress.h"

/// @file
/// Settings common to all pipelines, and how they report messages: pipelines print nothing but
/// their progress.

namespace haarlight::relight {

enum class NoteKind {
  result,   ///< a line of what was found, as it is found
  note,     ///< worth knowing; nothing is wrong
  caution,  ///< limits the validity of the results
  warning,  ///< the input contradicts itself, or contains less than it seems to
  failure,  ///< a request that is not met: why the command ends with exit code 1
};

/// One message to the user: one line or several, without a trailing line break.
struct PipelineNote {
  NoteKind kind = NoteKind::note;
  std::string text;
  friend bool operator==(const PipelineNote&, const PipelineNote&) = default;
};

using TellNote = std::function<void(const PipelineNote& note)>;

struct PipelineSettings {
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  ProgressStyle progress = ProgressStyle::none;
  bool overwrites = false;  ///< an output that exists
  /// Called with each note when it is known, on the caller's thread; empty: only summaries hold
  /// them.
  TellNote tell{};
};

/// A pipeline's notes in the order in which they were found. One thread.
class PipelineNotes {
 public:
  explicit PipelineNotes(TellNote tell) : tell_(std::move(tell)) {}
  void add(NoteKind kind, std::string text);
  [[nodiscard]] const std::vector<PipelineNote>& all() const noexcept { return notes_; }

 private:
  TellNote tell_;
  std::vector<PipelineNote> notes_;
};

}  // namespace haarlight::relight
