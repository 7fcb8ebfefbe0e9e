// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "core/json_value.h"
#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "session/frame_tiff.h"
#include "session/verify_checks.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

std::string file_of(const JournalEvent& event) {
  try {
    const JsonValue value = JsonValue::parse(event.json, "journal.sqlite");
    return value.has("file") ? value["file"].text() : std::string();
  } catch (const Error&) {
    return {};
  }
}

/// By value, not by text: later programs write fields that an existing row lacks.
bool is_evidence(const std::string& json, const FrameEvidence& evidence) {
  try {
    return evidence_from_json(json, "journal.sqlite") == evidence;
  } catch (const Error&) {
    return false;
  }
}

/// Ids are assigned once, in order, from 1: a gap is a line that was removed.
template <class Items, class Id>
void check_ids(const Items& items, Id id, const char* what, VerifyReport& report) {
  std::int64_t expected = 1;
  for (const auto& item : items) {
    if (id(item) != expected) {
      report.problems.push_back(
          fmt::format("journal.sqlite: {} {} is missing", what, expected));
      return;
    }
    ++expected;
  }
}

void check_history(const fs::path& folder, const JournalContents& journal,
                   VerifyReport& report) {
  check_ids(
      journal.row_ids, [](std::int64_t id) { return id; }, "row", report);
  check_ids(
      journal.events, [](const JournalEvent& event) { return event.id; }, "event", report);
  if (journal.events.empty() || journal.events.back().kind != EventKind::finished) {
    report.problems.emplace_back(
        "journal.sqlite: its last event is not that the session was finished (opened again: "
        "finish it, haarlight capture)");
  }
  std::set<std::pair<std::optional<EventKind>, std::string>> said;
  for (const JournalEvent& event : journal.events) {
    said.emplace(event.kind, file_of(event));
  }
  std::set<std::string> with_row;
  std::error_code ignored;
  for (const JournalRow& row : journal.rows) {
    const bool is_kept = row.state != RowState::returned;
    if (is_kept) {
      with_row.insert(row.file);
      if (row.file != frame_file_name(row.shot, row.attempt)) {
        report.problems.push_back(fmt::format("{}: the journal has it as shot {} attempt {}",
                                              row.file, row.shot, row.attempt));
      } else if (!fs::exists(fs::symlink_status(folder / row.file, ignored))) {
        report.problems.push_back(row.file + ": missing, the journal has its row");
      }
    }
    const bool is_committed = row.state == RowState::committed;
    const EventKind kind =
        row.state == RowState::returned ? EventKind::returned : EventKind::withdrawn;
    const bool is_said = said.count({kind, row.file}) != 0;
    if (!is_committed && !is_said) {
      report.problems.push_back(fmt::format("journal.sqlite: {} is {}, and no event says so",
                                            row.file, to_string(row.state)));
    }
    if (is_committed && is_said) {
      report.notes.push_back(row.file + ": an event withdrew it, its row counts all the same");
    }
  }
  std::set<std::string> without_row;
  std::error_code error;
  for (fs::directory_iterator it(folder / "frames", error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = "frames/" + it->path().filename().string();
    if (with_row.count(name) == 0) {
      without_row.insert(name);
    }
  }
  for (const std::string& name : without_row) {
    report.problems.push_back(name + ": the journal has no row of it");
  }
}

}  // namespace

void check_journal(const fs::path& folder, const SessionInfo& info, VerifyReport& report) {
  const fs::path file = folder / "journal.sqlite";
  const auto sealed =
      std::find_if(info.files.begin(), info.files.end(),
                   [](const SealedFile& f) { return f.name == "journal.sqlite"; });
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    if (info.evidence != EvidenceKind::asserted || sealed != info.files.end()) {
      report.problems.emplace_back(
          "journal.sqlite: missing (haarlight rebuild makes it again)");
    }
    return;
  }
  if (fs::exists(folder / "journal.sqlite-wal", ignored)) {
    return;  // already reported by check_kinds
  }
  const auto journal = read_journal(file, info.id);
  if (!journal) {
    report.problems.push_back("journal.sqlite: " + journal.error().what);
    return;
  }
  if (!info.root.empty() &&
      (sealed == info.files.end() ||
       to_hex(leaf_hash("journal.sqlite", journal->text)) != sealed->sha256)) {
    report.problems.emplace_back(
        "journal.sqlite: not as it was when the session was finished: SHA-256 of its tables "
        "differs");
  }
  std::map<int, const JournalRow*> newest;
  for (const JournalRow& row : journal->rows) {
    if (row.state == RowState::committed) {
      newest[row.shot] = &row;  // rows come by shot and attempt
    }
  }
  for (const FrameRecord& frame : info.frames) {
    const auto found = newest.find(frame.shot);
    if (found == newest.end() || found->second->attempt != frame.attempt ||
        found->second->file != frame.file || found->second->file_hash != frame.file_hash ||
        !is_evidence(found->second->evidence, frame.evidence)) {
      report.problems.push_back(
          fmt::format("{}: the journal's row differs from session.json", frame.file));
    }
  }
  if (newest.size() != info.frames.size()) {
    report.problems.push_back(
        fmt::format("journal.sqlite: {} committed shots, session.json has {}", newest.size(),
                    info.frames.size()));
  }
  check_history(folder, *journal, report);
}

}  // namespace haarlight::session
