// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"
#include "session/event_kind.h"
#include "session/storage.h"

/// @file
/// The journal of a session being captured: an SQLite file (WAL, synchronous FULL, one owner)
/// that records which frames are committed, and what happened. Tables:
/// docs/reference/session-format.md. Only the .cpp includes SQLite. One thread.

namespace haarlight::session {

enum class RowState {
  committed,  ///< durable frame, evidence good
  withdrawn,  ///< another attempt was requested
  returned,   ///< recovery found the frame missing or altered
};
inline constexpr auto kRowStateWords =
    std::to_array<std::string_view>({"committed", "withdrawn", "returned"});
constexpr std::span<const std::string_view> words_of(RowState) { return kRowStateWords; }

struct JournalRow {
  int shot = 0;
  int attempt = 0;
  std::string file;
  std::string file_hash;
  std::string evidence;  ///< JSON
  RowState state = RowState::committed;
};

struct JournalEvent {
  std::int64_t id = 0;
  std::optional<EventKind> kind;  ///< nothing: of a later program
  std::string json;
};

class Journal {
 public:
  /// Opens or creates the file for this process alone.
  /// Fault protocol: not a journal of this session, or damaged (it may be rebuilt from the
  /// frames); device_busy: another process has it.
  [[nodiscard]] static Result<Journal> open(const std::filesystem::path& file,
                                            const std::string& session_id, Storage& storage);
  ~Journal();
  Journal(Journal&&) noexcept;
  Journal& operator=(Journal&&) noexcept;
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// The file was missing or empty: no existing frame can have a row.
  [[nodiscard]] bool is_new() const;
  /// Every row, by shot and attempt.
  [[nodiscard]] Result<std::vector<JournalRow>> rows();
  /// The full contents of the tables as text: the part of a journal that the session's root
  /// covers (layout: docs/reference/session-format.md). Excludes SQLite's own bookkeeping.
  [[nodiscard]] Result<std::string> text();
  /// All rows in one transaction, durable on return; on a Fault none is there.
  [[nodiscard]] Result<void> insert(std::span<const JournalRow> rows);
  /// Durable. Rows of the shot and attempt get the state.
  [[nodiscard]] Result<void> set_state(int shot, int attempt, RowState state);

  /// Not synced by itself: durable with the next insert or close. @return the event's id
  [[nodiscard]] Result<std::int64_t> log(EventKind kind, const std::string& json);
  /// Events after `id`, oldest first, at most `limit`.
  [[nodiscard]] Result<std::vector<JournalEvent>> events_after(std::int64_t id, int limit);

  /// Moves everything out of the WAL, leaves WAL mode (so that a read-only copy can be opened),
  /// closes.
  [[nodiscard]] Result<void> close_for_archive();

 private:
  struct Impl;
  explicit Journal(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// A finished session's journal.
struct JournalContents {
  std::vector<JournalRow> rows;       ///< by shot and attempt
  std::vector<std::int64_t> row_ids;  ///< of all rows, ascending
  std::vector<JournalEvent> events;   ///< by id
  std::string text;                   ///< as Journal::text()
};

/// Opened read-only. Fault protocol: damaged; io: not there.
[[nodiscard]] Result<JournalContents> read_journal(const std::filesystem::path& file,
                                                   const std::string& session_id);

}  // namespace haarlight::session
