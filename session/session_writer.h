// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/error.h"
#include "haarlight/core/image.h"
#include "haarlight/session/session.h"
#include "session/journal.h"
#include "session/storage.h"

/// @file
/// Writes a session so that nothing committed is ever lost: frame to a temporary name, fsync,
/// rename, folder fsync, and only then the journal row COMMITTED (SQLite, WAL,
/// synchronous=FULL). One thread.

namespace haarlight::session {

/// What recovery found and did; every item is also a journal event.
struct RecoveryReport {
  int n_committed = 0;  ///< rows whose frame is present and whose hash matches
  int n_adopted = 0;    ///< frames without a row, evidence complete, hash good: now rows
  int n_returned = 0;   ///< rows whose frame is missing or altered: pending again
  std::vector<std::string> set_aside;  ///< files moved to aside/, with the reason
};

/// A frame to be written. Pixels hold stored_height rows.
struct PendingFrame {
  int shot = 0;
  int attempt = 0;
  FrameEvidence evidence;
  ImageView<const std::uint16_t> pixels;
};

class SessionWriter {
 public:
  /// Creates a new session folder: rig.toml, plan.json, empty journal, frames/, aside/;
  /// reserves `reserve_bytes` on the disk. `info.frames` is empty. On a Fault nothing of it
  /// remains.
  [[nodiscard]] static Result<SessionWriter> create(
      const std::filesystem::path& folder, const SessionInfo& info, const std::string& rig_toml,
      const std::string& plan_json, std::uint64_t reserve_bytes, Storage& storage);
  /// Removes what an interrupted create() left: a folder without start.json and session.json
  /// that holds nothing but what create() itself makes. A frame, or any other file, keeps the
  /// folder as it is. create() calls this itself when it fails.
  /// @return whether it was one, and is gone
  static bool discard_unmade(const std::filesystem::path& folder, Storage& storage);
  /// Opens an unfinished (or finished) session, recovers it, and continues.
  [[nodiscard]] static Result<SessionWriter> reopen(const std::filesystem::path& folder,
                                                    Storage& storage);
  ~SessionWriter();
  SessionWriter(SessionWriter&&) noexcept;
  SessionWriter& operator=(SessionWriter&&) noexcept;
  SessionWriter(const SessionWriter&) = delete;
  SessionWriter& operator=(const SessionWriter&) = delete;

  [[nodiscard]] const SessionInfo& info() const;
  [[nodiscard]] const RecoveryReport& recovery() const;
  /// Shots that have a committed frame, one flag per shot.
  [[nodiscard]] const std::vector<bool>& committed() const;
  /// Of the committed frames, by shot.
  [[nodiscard]] std::vector<std::pair<int, FrameEvidence>> committed_evidence() const;
  /// Attempts already used by a shot, which is the next attempt's number.
  [[nodiscard]] int next_attempt(int shot) const;
  /// The plan as stored, bytes unchanged.
  [[nodiscard]] const std::string& plan_json() const;

  /// Checks each frame's pixels against its evidence (hash, clean rule: Fault refused or
  /// protocol, nothing written), then makes the frames durable, then their rows, in one journal
  /// transaction. On a Fault none of the rows exists, the caller still owns the buffers, and
  /// the call may be repeated (after a failed fsync a new file is written).
  [[nodiscard]] Result<void> commit(std::span<const PendingFrame> frames);

  /// Keeps an attempt that the pixel checks refused: its frame goes to aside/ with the reason
  /// next to it, never to frames/, so that no recovery adopts it. Durable on return.
  [[nodiscard]] Result<void> keep_refused(const PendingFrame& frame, const std::string& reason);

  /// Marks a shot pending again (reshoot); old attempts stay on disk and in the journal. A
  /// session.json goes aside first: the session is unfinished until finish() writes a new one.
  [[nodiscard]] Result<void> withdraw(int shot, const std::string& reason);

  /// Appends to the journal's event log (state changes, faults, discarded frames). The row's
  /// number is the id in the daemon's event stream. Not synced by itself: durable with the next
  /// commit.
  Result<std::int64_t> log_event(EventKind kind, const std::string& json);

  /// Events after row `id`, oldest first, at most `limit` (Last-Event-ID of the event stream).
  [[nodiscard]] Result<std::vector<JournalEvent>> events_after(std::int64_t id,
                                                               int limit) const;

  /// finish() has closed the journal; only reopen() can continue.
  [[nodiscard]] bool is_finished() const;

  /// Writes session.json with its root (session/seal.h; the files in aside/ are read once
  /// more), checkpoints the journal and takes it out of WAL mode. Every shot must be committed.
  [[nodiscard]] Result<void> finish();

 private:
  struct Impl;
  [[nodiscard]] static Result<SessionWriter> make(
      const std::filesystem::path& folder, const SessionInfo& info, const std::string& rig_toml,
      const std::string& plan_json, std::uint64_t reserve_bytes, Storage& storage);
  explicit SessionWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace haarlight::session
