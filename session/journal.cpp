// SPDX-License-Identifier: Apache-2.0
#include "session/journal.h"

#include <array>
#include <initializer_list>
#include <limits>
#include <utility>

#include <fmt/format.h>
#include <sqlite3.h>

namespace haarlight::session {

namespace {

constexpr int kFormat = 1;

struct CloseDatabase {
  void operator()(sqlite3* database) const noexcept { sqlite3_close_v2(database); }
};
using Database = std::unique_ptr<sqlite3, CloseDatabase>;

struct FinaliseStatement {
  void operator()(sqlite3_stmt* statement) const noexcept { sqlite3_finalize(statement); }
};
using Statement = std::unique_ptr<sqlite3_stmt, FinaliseStatement>;

Errc code_of(int sqlite_code) {
  switch (sqlite_code & 0xff) {
    case SQLITE_FULL:
      return Errc::no_space;
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return Errc::device_busy;
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
    case SQLITE_SCHEMA:
    case SQLITE_ERROR:
    case SQLITE_CONSTRAINT:
      return Errc::protocol;
    default:
      return Errc::io;
  }
}

tl::unexpected<Fault> journal_fault(sqlite3* database, const char* operation,
                                    const std::filesystem::path& file) {
  const int code = sqlite3_extended_errcode(database);
  return fail(code_of(code),
              fmt::format("{} {}: {}", operation, file.string(), sqlite3_errmsg(database)),
              sqlite3_system_errno(database));
}

/// A query being stepped; text and integers bound by position from 1.
class Query {
 public:
  Query(sqlite3* database, const char* sql) {
    sqlite3_stmt* statement = nullptr;
    result_ = sqlite3_prepare_v2(database, sql, -1, &statement, nullptr);
    statement_.reset(statement);
  }
  Query& bind(int position, std::int64_t value) {
    if (statement_) {
      sqlite3_bind_int64(statement_.get(), position, value);
    }
    return *this;
  }
  Query& bind(int position, const std::string& value) {
    if (statement_) {
      sqlite3_bind_text(statement_.get(), position, value.data(),
                        static_cast<int>(value.size()), SQLITE_TRANSIENT);
    }
    return *this;
  }
  /// True while there is a row.
  bool step() {
    if (statement_) {
      result_ = sqlite3_step(statement_.get());
    }
    return result_ == SQLITE_ROW;
  }
  [[nodiscard]] bool is_done() const { return result_ == SQLITE_DONE || result_ == SQLITE_ROW; }
  [[nodiscard]] std::int64_t integer(int column) const {
    return sqlite3_column_int64(statement_.get(), column);
  }
  [[nodiscard]] std::string text(int column) const {
    const auto* bytes =
        reinterpret_cast<const char*>(sqlite3_column_text(statement_.get(), column));
    const int size = sqlite3_column_bytes(statement_.get(), column);
    return bytes == nullptr ? std::string()
                            : std::string(bytes, static_cast<std::size_t>(size));
  }

 private:
  Statement statement_;
  int result_ = SQLITE_OK;
};

constexpr const char* kSelectRows =
    "SELECT shot, attempt, file, file_hash, evidence, state FROM frames ORDER BY shot, attempt";

Result<std::vector<JournalRow>> select_rows(sqlite3* database,
                                            const std::filesystem::path& file) {
  std::vector<JournalRow> rows;
  Query query(database, kSelectRows);
  while (query.step()) {
    JournalRow row;
    row.shot = static_cast<int>(query.integer(0));
    row.attempt = static_cast<int>(query.integer(1));
    row.file = query.text(2);
    row.file_hash = query.text(3);
    row.evidence = query.text(4);
    const std::string state = query.text(5);
    const std::optional<RowState> known = value_of<RowState>(state);
    if (!known) {
      return fail(Errc::protocol,
                  fmt::format("{}: a row of state \"{}\"", file.string(), state));
    }
    row.state = *known;
    rows.push_back(std::move(row));
  }
  if (!query.is_done()) {
    return journal_fault(database, "read", file);
  }
  return rows;
}

/// Every value as its length in bytes, ":" and its bytes; one line per row, a blank line per
/// table.
Result<std::string> select_text(sqlite3* database, const std::filesystem::path& file) {
  constexpr std::array<std::pair<const char*, int>, 4> kTables = {
      std::pair{"SELECT type, name, ifnull(sql, '') FROM sqlite_master ORDER BY type, name", 3},
      std::pair{"SELECT format, session FROM meta ORDER BY rowid", 2},
      std::pair{"SELECT id, shot, attempt, file, file_hash, evidence, state FROM frames "
                "ORDER BY id",
                7},
      std::pair{"SELECT id, kind, json FROM events ORDER BY id", 3}};
  std::string text;
  for (const auto& [sql, n_columns] : kTables) {
    Query query(database, sql);
    while (query.step()) {
      for (int column = 0; column < n_columns; ++column) {
        const std::string value = query.text(column);
        text += fmt::format("{}:", value.size()) + value;
      }
      text += '\n';
    }
    if (!query.is_done()) {
      return journal_fault(database, "read", file);
    }
    text += '\n';
  }
  return text;
}

Result<std::vector<JournalEvent>> select_events(sqlite3* database,
                                                const std::filesystem::path& file,
                                                std::int64_t id, int limit) {
  std::vector<JournalEvent> events;
  Query query(database, "SELECT id, kind, json FROM events WHERE id > ?1 ORDER BY id LIMIT ?2");
  query.bind(1, id).bind(2, std::int64_t{limit});
  while (query.step()) {
    events.push_back({query.integer(0), value_of<EventKind>(query.text(1)), query.text(2)});
  }
  if (!query.is_done()) {
    return journal_fault(database, "read", file);
  }
  return events;
}

Result<void> check_meta(sqlite3* database, const std::filesystem::path& file,
                        const std::string& session_id) {
  Query query(database, "SELECT format, session FROM meta");
  if (!query.step()) {
    return query.is_done() ? fail(Errc::protocol, file.string() + ": an empty meta table")
                           : journal_fault(database, "read", file);
  }
  if (query.integer(0) != kFormat || query.text(1) != session_id) {
    return fail(
        Errc::protocol,
        fmt::format("{}: journal format {} of session {}, expected {} of {}", file.string(),
                    query.integer(0), query.text(1), kFormat, session_id));
  }
  return {};
}

Result<void> check_integrity(sqlite3* database, const std::filesystem::path& file) {
  Query query(database, "PRAGMA integrity_check(1)");
  if (!query.step()) {
    return journal_fault(database, "check", file);
  }
  if (query.text(0) != "ok") {
    return fail(Errc::protocol, file.string() + ": damaged: " + query.text(0));
  }
  return {};
}

}  // namespace

struct Journal::Impl {
  std::filesystem::path file;
  Storage* storage = nullptr;
  Database database;
  bool is_new = false;

  [[nodiscard]] sqlite3* db() const { return database.get(); }

  /// One step of the journal: the test's stop hook first, then SQL that returns nothing.
  [[nodiscard]] Result<void> step(const char* sql) const {
    if (auto allowed = storage->journal_step(); !allowed) {
      return allowed;
    }
    return execute(sql);
  }

  [[nodiscard]] Result<void> execute(const char* sql) const {
    if (sqlite3_exec(db(), sql, nullptr, nullptr, nullptr) != SQLITE_OK) {
      return journal_fault(db(), sql, file);
    }
    return {};
  }

  [[nodiscard]] Result<void> run(Query& query, const char* operation) const {
    if (auto allowed = storage->journal_step(); !allowed) {
      return allowed;
    }
    query.step();
    if (!query.is_done()) {
      return journal_fault(db(), operation, file);
    }
    return {};
  }

  void roll_back() const noexcept {
    if (sqlite3_get_autocommit(db()) == 0) {
      sqlite3_exec(db(), "ROLLBACK", nullptr, nullptr, nullptr);
    }
  }

  /// Runs `body` inside a transaction that is durable when this returns.
  template <class Body>
  [[nodiscard]] Result<void> transact(Body body) {
    auto result = step("BEGIN IMMEDIATE");
    if (result) {
      result = body();
    }
    if (result) {
      result = step("COMMIT");
    }
    if (!result) {
      roll_back();
    }
    return result;
  }

  [[nodiscard]] Result<void> set_up(const std::string& session_id);
};

Result<void> Journal::Impl::set_up(const std::string& session_id) {
  // One owner: the WAL's index is then kept in memory, and a second writer is refused. Nothing
  // is written before the file has proved to be this session's sound journal.
  const auto run_all = [this](std::initializer_list<const char*> statements) -> Result<void> {
    for (const char* sql : statements) {
      if (auto done = step(sql); !done) {
        return done;
      }
    }
    return {};
  };
  if (auto done = run_all({"PRAGMA locking_mode=EXCLUSIVE", "PRAGMA trusted_schema=OFF",
                           "PRAGMA cell_size_check=ON"});
      !done) {
    return done;
  }
  if (auto sound = check_integrity(db(), file); !sound) {
    return sound;
  }
  {
    Query query(db(), "SELECT count(*) FROM sqlite_master");
    if (!query.step()) {
      return journal_fault(db(), "read", file);
    }
    is_new = query.integer(0) == 0;
  }
  if (!is_new) {
    if (auto own = check_meta(db(), file, session_id); !own) {
      return own;
    }
    if (auto rows = select_rows(db(), file); !rows) {
      return tl::unexpected<Fault>(rows.error());
    }
  }
  if (auto done = run_all({"PRAGMA journal_mode=WAL", "PRAGMA synchronous=FULL",
                           "PRAGMA wal_autocheckpoint=1000"});
      !done) {
    return done;
  }
  {
    Query mode(db(), "PRAGMA journal_mode");
    if (!mode.step() || mode.text(0) != "wal") {
      return fail(Errc::unsupported, file.string() + ": this file system does not take a WAL");
    }
  }
  if (!is_new) {
    return {};
  }
  return transact([&]() -> Result<void> {
    for (const char* sql :
         {"CREATE TABLE meta (format INTEGER NOT NULL, session TEXT NOT NULL)",
          "CREATE TABLE frames (id INTEGER PRIMARY KEY, shot INTEGER NOT NULL, "
          "attempt INTEGER NOT NULL, file TEXT NOT NULL, file_hash TEXT NOT NULL, "
          "evidence TEXT NOT NULL, state TEXT NOT NULL, UNIQUE (shot, attempt))",
          "CREATE TABLE events (id INTEGER PRIMARY KEY AUTOINCREMENT, kind TEXT NOT NULL, "
          "json TEXT NOT NULL)"}) {
      if (auto done = step(sql); !done) {
        return done;
      }
    }
    Query insert(db(), "INSERT INTO meta VALUES (?1, ?2)");
    insert.bind(1, std::int64_t{kFormat}).bind(2, session_id);
    return run(insert, "insert meta");
  });
}

Journal::Journal(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Journal::~Journal() = default;
Journal::Journal(Journal&&) noexcept = default;
Journal& Journal::operator=(Journal&&) noexcept = default;

Result<Journal> Journal::open(const std::filesystem::path& file, const std::string& session_id,
                              Storage& storage) {
  auto impl = std::make_unique<Impl>();
  impl->file = file;
  impl->storage = &storage;
  const std::string vfs = storage.journal_vfs();
  sqlite3* database = nullptr;
  // NOFOLLOW is meant for the file: its path may contain links (a session that was moved, a
  // sessions folder on another disk).
  std::error_code ignored;
  const std::filesystem::path folder = std::filesystem::canonical(file.parent_path(), ignored);
  const std::filesystem::path target = ignored ? file : folder / file.filename();
  const int code = sqlite3_open_v2(
      target.c_str(), &database,
      SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_NOFOLLOW,
      vfs.empty() ? nullptr : vfs.c_str());
  impl->database.reset(database);
  if (code != SQLITE_OK) {
    if (database == nullptr) {
      return fail(Errc::io, "open " + file.string() + ": " + sqlite3_errstr(code));
    }
    return journal_fault(database, "open", file);
  }
  sqlite3_extended_result_codes(database, 1);
  if (auto ready = impl->set_up(session_id); !ready) {
    return tl::unexpected<Fault>(ready.error());
  }
  return Journal(std::move(impl));
}

bool Journal::is_new() const { return impl_->is_new; }

Result<std::string> Journal::text() { return select_text(impl_->db(), impl_->file); }

Result<std::vector<JournalRow>> Journal::rows() {
  return select_rows(impl_->db(), impl_->file);
}

Result<void> Journal::insert(std::span<const JournalRow> rows) {
  return impl_->transact([&]() -> Result<void> {
    for (const JournalRow& row : rows) {
      Query query(impl_->db(),
                  "INSERT INTO frames (shot, attempt, file, file_hash, evidence, state) "
                  "VALUES (?1, ?2, ?3, ?4, ?5, ?6)");
      query.bind(1, std::int64_t{row.shot})
          .bind(2, std::int64_t{row.attempt})
          .bind(3, row.file)
          .bind(4, row.file_hash)
          .bind(5, row.evidence)
          .bind(6, std::string(to_string(row.state)));
      if (auto done = impl_->run(query, "insert into"); !done) {
        return done;
      }
    }
    return {};
  });
}

Result<void> Journal::set_state(int shot, int attempt, RowState state) {
  return impl_->transact([&]() -> Result<void> {
    Query query(impl_->db(), "UPDATE frames SET state = ?3 WHERE shot = ?1 AND attempt = ?2");
    query.bind(1, std::int64_t{shot})
        .bind(2, std::int64_t{attempt})
        .bind(3, std::string(to_string(state)));
    return impl_->run(query, "update");
  });
}

Result<std::int64_t> Journal::log(EventKind kind, const std::string& json) {
  // NORMAL does not sync the WAL at this commit; the next FULL commit syncs all of it.
  if (auto done = impl_->execute("PRAGMA synchronous=NORMAL"); !done) {
    return tl::unexpected<Fault>(done.error());
  }
  Query query(impl_->db(), "INSERT INTO events (kind, json) VALUES (?1, ?2)");
  query.bind(1, std::string(to_string(kind))).bind(2, json);
  const auto written = impl_->run(query, "insert into");
  const std::int64_t id = sqlite3_last_insert_rowid(impl_->db());
  query = Query(impl_->db(), "SELECT 1");  // ends the insert before the pragma
  if (auto done = impl_->execute("PRAGMA synchronous=FULL"); !done) {
    return tl::unexpected<Fault>(done.error());
  }
  if (!written) {
    return tl::unexpected<Fault>(written.error());
  }
  return id;
}

Result<std::vector<JournalEvent>> Journal::events_after(std::int64_t id, int limit) {
  return select_events(impl_->db(), impl_->file, id, limit);
}

Result<void> Journal::close_for_archive() {
  for (const char* sql : {"PRAGMA wal_checkpoint(TRUNCATE)", "PRAGMA journal_mode=DELETE"}) {
    if (auto done = impl_->step(sql); !done) {
      return done;
    }
  }
  Query mode(impl_->db(), "PRAGMA journal_mode");
  if (!mode.step() || mode.text(0) != "delete") {
    return fail(Errc::io, impl_->file.string() + ": the journal did not leave WAL mode");
  }
  mode = Query(impl_->db(), "SELECT 1");
  impl_->database.reset();
  return {};
}

Result<JournalContents> read_journal(const std::filesystem::path& file,
                                     const std::string& session_id) {
  std::error_code ignored;
  if (!std::filesystem::exists(file, ignored)) {
    return fail(Errc::io, file.string() + ": not there");
  }
  sqlite3* raw = nullptr;
  const int code =
      sqlite3_open_v2(file.c_str(), &raw, SQLITE_OPEN_READONLY | SQLITE_OPEN_NOMUTEX, nullptr);
  const Database database(raw);
  if (code != SQLITE_OK) {
    return fail(Errc::io, "open " + file.string() + ": " + sqlite3_errstr(code));
  }
  if (auto sound = check_integrity(raw, file); !sound) {
    return tl::unexpected<Fault>(sound.error());
  }
  if (auto own = check_meta(raw, file, session_id); !own) {
    return tl::unexpected<Fault>(own.error());
  }
  JournalContents contents;
  auto rows = select_rows(raw, file);
  if (!rows) {
    return tl::unexpected<Fault>(rows.error());
  }
  contents.rows = std::move(*rows);
  Query ids(raw, "SELECT id FROM frames ORDER BY id");
  while (ids.step()) {
    contents.row_ids.push_back(ids.integer(0));
  }
  auto events = select_events(raw, file, 0, std::numeric_limits<int>::max());
  if (!events) {
    return tl::unexpected<Fault>(events.error());
  }
  contents.events = std::move(*events);
  auto text = select_text(raw, file);
  if (!text) {
    return tl::unexpected<Fault>(text.error());
  }
  contents.text = std::move(*text);
  return contents;
}

}  // namespace haarlight::session
