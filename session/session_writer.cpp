// SPDX-License-Identifier: Apache-2.0
#include "session/session_writer.h"

#include <algorithm>
#include <map>
#include <utility>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/clean_rule.h"
#include "session/frame_check.h"
#include "session/frame_tiff.h"
#include "session/journal.h"
#include "session/seal.h"
#include "session/signature.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr const char* kStart = "start.json";
constexpr const char* kJournal = "journal.sqlite";
constexpr const char* kReserve = "reserve.bin";
constexpr std::uintmax_t kMaxText = std::uintmax_t{1} << 30U;

template <class T>
tl::unexpected<Fault> pass_on(const Result<T>& result) {
  return tl::unexpected<Fault>(result.error());
}

std::string reason_json(const std::string& subject, const std::string& reason) {
  const nlohmann::ordered_json json = {{"file", subject}, {"reason", reason}};
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

Result<void> make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) {
    return fail(error == std::errc::no_space_on_device ? Errc::no_space : Errc::io,
                "mkdir " + folder.string() + ": " + error.message(), error.value());
  }
  return {};
}

}  // namespace

struct SessionWriter::Impl {
  fs::path folder;
  Storage* storage = nullptr;
  SessionInfo info;
  std::string plan;
  std::optional<Journal> journal;
  RecoveryReport recovery;
  std::vector<bool> committed;
  std::vector<int> next_attempt;
  std::map<std::pair<int, int>, JournalRow> rows;     ///< by shot and attempt
  std::map<std::pair<int, int>, std::string> leaves;  ///< leaf_hash of their files
  std::string setup;                                  ///< setup_hash(info)
  bool is_rebuilt = false;   ///< the rows are not those written during the capture
  std::string journal_text;  ///< once the journal is closed
  std::uint64_t reserved = 0;
  int n_temporaries = 0;

  [[nodiscard]] fs::path frames() const { return folder / "frames"; }
  [[nodiscard]] fs::path aside() const { return folder / "aside"; }

  /// Writes a file whole: a new temporary name, sync, rename. The folder is not synced yet.
  [[nodiscard]] Result<void> write_renamed(const fs::path& path,
                                           std::span<const std::byte> bytes);
  [[nodiscard]] Result<void> write_durably(const fs::path& path, const std::string& text);

  /// Moves a file to aside/ with a note of the reason next to it; overwrites nothing there.
  [[nodiscard]] Result<void> set_aside(const fs::path& file, const std::string& reason);
  [[nodiscard]] Result<void> set_session_json_aside(const std::string& reason);
  [[nodiscard]] Result<void> note_rebuilding();
  [[nodiscard]] Result<void> note_events_of_aside();

  [[nodiscard]] Result<void> open_journal();
  [[nodiscard]] Result<void> check_rows();
  [[nodiscard]] Result<void> adopt_frames();
  [[nodiscard]] Result<void> sweep_temporaries();
  [[nodiscard]] Result<void> sweep_orphans();
  void shrink_reserve(std::uint64_t bytes);
  void note_attempt(int shot, int attempt);
  void note_row(const JournalRow& row);
  void refresh_committed(int shot);
  [[nodiscard]] Result<void> check_frame(const PendingFrame& frame) const;
  [[nodiscard]] std::vector<FrameRecord> frame_records() const;
};

Result<void> SessionWriter::Impl::write_renamed(const fs::path& path,
                                                std::span<const std::byte> bytes) {
  fs::path temporary = path;
  temporary += fmt::format(".new{}", ++n_temporaries);
  auto done = storage->write(temporary, bytes);
  if (done) {
    done = storage->sync_file(temporary);
  }
  if (done) {
    done = storage->rename(temporary, path);
  }
  if (!done) {
    // After a failed write or sync its pages cannot be trusted and its blocks are needed; the
    // caller still has the bytes, and a repeated call uses a new name.
    (void)storage->remove(temporary);
  }
  return done;
}

Result<void> SessionWriter::Impl::write_durably(const fs::path& path, const std::string& text) {
  if (auto done = write_renamed(path, std::as_bytes(std::span(text))); !done) {
    return done;
  }
  return storage->sync_folder(path.parent_path());
}

Result<void> SessionWriter::Impl::set_aside(const fs::path& file, const std::string& reason) {
  std::error_code ignored;
  fs::path target = aside() / file.filename();
  for (int i = 2; fs::exists(target, ignored); ++i) {
    target = aside() / fmt::format("{}.{}", file.filename().string(), i);
  }
  if (auto done = storage->rename(file, target); !done) {
    return done;
  }
  fs::path note = target;
  note += ".why.txt";
  const std::string text = fmt::format("{}: {}\n", file.filename().string(), reason);
  if (auto done = storage->write(note, std::as_bytes(std::span(text))); !done) {
    return done;
  }
  if (auto done = storage->sync_file(note); !done) {
    return done;
  }
  recovery.set_aside.push_back(
      fmt::format("{}: {}", fs::relative(target, folder, ignored).string(), reason));
  return {};
}

/// Before a shot of a finished session is withdrawn: if the daemon dies before the new frame is
/// there, it finds an unfinished session and resumes it. The signature goes aside too.
Result<void> SessionWriter::Impl::set_session_json_aside(const std::string& reason) {
  std::error_code ignored;
  bool is_any = false;
  for (const char* name : {"session.json", kSignatureFile}) {
    if (!fs::exists(folder / name, ignored)) {
      continue;
    }
    is_any = true;
    if (auto done = set_aside(folder / name, reason); !done) {
      return done;
    }
  }
  if (!is_any) {
    return {};
  }
  if (auto done = storage->sync_folder(aside()); !done) {
    return done;
  }
  return storage->sync_folder(folder);
}

Result<void> SessionWriter::Impl::note_events_of_aside() {
  for (const std::string& item : recovery.set_aside) {
    const std::size_t colon = item.find(": ");
    if (auto id = journal->log(EventKind::set_aside,
                               reason_json(item.substr(0, colon), item.substr(colon + 2)));
        !id) {
      return pass_on(id);
    }
  }
  if (!recovery.set_aside.empty()) {
    if (auto done = storage->sync_folder(aside()); !done) {
      return done;
    }
  }
  return {};
}

Result<void> SessionWriter::Impl::open_journal() {
  auto opened = Journal::open(folder / kJournal, info.id, *storage);
  if (!opened && opened.error().code == Errc::protocol) {
    // A journal that cannot be trusted is set aside whole; its rows are rebuilt from the
    // frames.
    const std::string reason = opened.error().what;
    std::error_code ignored;
    for (const char* ending : {"", "-wal", "-shm", "-journal"}) {
      const fs::path file = folder / (std::string(kJournal) + ending);
      if (fs::exists(file, ignored)) {
        if (auto done = set_aside(file, reason); !done) {
          return done;
        }
      }
    }
    opened = Journal::open(folder / kJournal, info.id, *storage);
  }
  if (!opened) {
    return pass_on(opened);
  }
  journal.emplace(std::move(*opened));
  return storage->sync_folder(folder);
}

/// A journal that is lost, set aside or empty existed before start.json: its rows now come from
/// the frames alone, and the session records that permanently.
Result<void> SessionWriter::Impl::note_rebuilding() {
  if (journal->is_new()) {
    const auto id = journal->log(
        EventKind::rebuilt, reason_json(kJournal, "made again: the rows come from the frames"));
    is_rebuilt = id.has_value();
    return id ? Result<void>() : pass_on(id);
  }
  constexpr int kAtOnce = 10000;
  for (std::int64_t last = 0; !is_rebuilt;) {
    const auto events = journal->events_after(last, kAtOnce);
    if (!events) {
      return pass_on(events);
    }
    if (events->empty()) {
      break;
    }
    is_rebuilt = std::any_of(events->begin(), events->end(), [](const JournalEvent& e) {
      return e.kind == EventKind::rebuilt;
    });
    last = events->back().id;
  }
  return {};
}

void SessionWriter::Impl::note_attempt(int shot, int attempt) {
  if (shot >= 0 && static_cast<std::size_t>(shot) < next_attempt.size()) {
    int& next = next_attempt[static_cast<std::size_t>(shot)];
    next = std::max(next, attempt + 1);
  }
}

void SessionWriter::Impl::refresh_committed(int shot) {
  bool is_committed = false;
  for (auto it = rows.lower_bound({shot, 0}); it != rows.end() && it->first.first == shot;
       ++it) {
    is_committed = is_committed || it->second.state == RowState::committed;
  }
  committed[static_cast<std::size_t>(shot)] = is_committed;
}

void SessionWriter::Impl::note_row(const JournalRow& row) {
  rows[{row.shot, row.attempt}] = row;
  note_attempt(row.shot, row.attempt);
  refresh_committed(row.shot);
}

/// A row whose frame is missing or altered goes back to pending.
Result<void> SessionWriter::Impl::check_rows() {
  auto stored = journal->rows();
  if (!stored) {
    return pass_on(stored);
  }
  for (JournalRow& row : *stored) {
    if (row.shot < 0 || static_cast<std::size_t>(row.shot) >= info.shots.size() ||
        row.attempt < 0 || row.file != frame_file_name(row.shot, row.attempt)) {
      return fail(Errc::protocol,
                  fmt::format("{}: a row of shot {} attempt {}, file {}, that the plan has not",
                              (folder / kJournal).string(), row.shot, row.attempt, row.file));
    }
    if (row.state != RowState::committed) {
      note_row(row);
      continue;
    }
    const fs::path file = folder / row.file;
    std::error_code ignored;
    std::string problem;
    if (!fs::exists(fs::symlink_status(file, ignored))) {
      problem = "the frame is missing";
    } else {
      const FrameInspection inspection = inspect_frame(file, info);
      leaves[{row.shot, row.attempt}] = inspection.sha256;
      if (inspection.file_hash != row.file_hash) {
        problem = "the file was altered after it was committed: its hash differs";
      } else if (!inspection.is_good()) {
        problem = inspection.problem;
      }
      if (!problem.empty()) {
        if (auto done = set_aside(file, problem); !done) {
          return done;
        }
      }
    }
    if (!problem.empty()) {
      row.state = RowState::returned;
      ++recovery.n_returned;
      if (auto id = journal->log(EventKind::returned, reason_json(row.file, problem)); !id) {
        return pass_on(id);
      }
      if (auto done = journal->set_state(row.shot, row.attempt, RowState::returned); !done) {
        return done;
      }
    } else {
      ++recovery.n_committed;
    }
    note_row(row);
  }
  return {};
}

/// A frame without a row is adopted when it is valid, otherwise set aside.
Result<void> SessionWriter::Impl::adopt_frames() {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator it(frames(), error), end; !error && it != end;
       it.increment(error)) {
    files.push_back(it->path());
  }
  if (error) {
    return fail(Errc::io, "read " + frames().string() + ": " + error.message(), error.value());
  }
  std::sort(files.begin(), files.end());
  std::vector<JournalRow> adopted;
  for (const fs::path& file : files) {
    int shot = 0;
    int attempt = 0;
    if (!parse_frame_file_name(file.filename().string(), shot, attempt)) {
      if (auto done = set_aside(file, "not a finished frame: its writer was stopped"); !done) {
        return done;
      }
      continue;
    }
    note_attempt(shot, attempt);
    if (rows.find({shot, attempt}) != rows.end()) {
      continue;
    }
    FrameInspection inspection = inspect_frame(file, info);
    if (inspection.is_good() &&
        (inspection.description.shot != shot || inspection.description.attempt != attempt)) {
      inspection.problem =
          fmt::format("it says it is shot {} attempt {}", inspection.description.shot,
                      inspection.description.attempt);
    }
    std::error_code ignored;
    if (inspection.is_good() &&
        fs::exists(aside() / fmt::format("{:06}_a{}.withdrawn.txt", shot, attempt), ignored)) {
      inspection.problem = "it was withdrawn";
    }
    if (!inspection.is_good()) {
      if (auto done = set_aside(file, inspection.problem); !done) {
        return done;
      }
      continue;
    }
    leaves[{shot, attempt}] = inspection.sha256;
    // It may have been renamed without its name being durable.
    if (auto done = storage->sync_file(file); !done) {
      return done;
    }
    adopted.push_back({shot, attempt, frame_file_name(shot, attempt), inspection.file_hash,
                       evidence_to_json(inspection.description.evidence), RowState::committed});
  }
  if (adopted.empty()) {
    return {};
  }
  if (auto done = storage->sync_folder(frames()); !done) {
    return done;
  }
  for (const JournalRow& row : adopted) {
    if (auto id = journal->log(EventKind::adopted,
                               reason_json(row.file, "a good frame without a row"));
        !id) {
      return pass_on(id);
    }
  }
  if (auto done = journal->insert(adopted); !done) {
    return done;
  }
  for (const JournalRow& row : adopted) {
    note_row(row);
  }
  recovery.n_adopted += static_cast<int>(adopted.size());
  return {};
}

/// Unfinished temporary files next to start.json, plan.json and session.json.
Result<void> SessionWriter::Impl::sweep_temporaries() {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    if (it->path().extension().string().rfind(".new", 0) == 0) {
      files.push_back(it->path());
    }
  }
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) {
    if (auto done = set_aside(file, "not finished: its writer was stopped"); !done) {
      return done;
    }
  }
  return {};
}

/// At the end: files of commits that failed and were not repeated with the same attempt.
Result<void> SessionWriter::Impl::sweep_orphans() {
  std::vector<fs::path> files;
  std::error_code error;
  for (fs::directory_iterator it(frames(), error), end; !error && it != end;
       it.increment(error)) {
    int shot = 0;
    int attempt = 0;
    if (!parse_frame_file_name(it->path().filename().string(), shot, attempt) ||
        rows.find({shot, attempt}) == rows.end()) {
      files.push_back(it->path());
    }
  }
  std::sort(files.begin(), files.end());
  const std::size_t n_before = recovery.set_aside.size();
  for (const fs::path& file : files) {
    if (auto done = set_aside(file, "its commit failed and was not repeated"); !done) {
      return done;
    }
  }
  if (recovery.set_aside.size() > n_before) {
    return note_events_of_aside();
  }
  return {};
}

void SessionWriter::Impl::shrink_reserve(std::uint64_t bytes) {
  if (reserved == 0) {
    return;
  }
  reserved -= std::min(reserved, bytes);
  // Releasing blocks cannot make things worse: a fault here shows up as no_space below.
  (void)storage->reserve(folder / kReserve, reserved);
}

Result<void> SessionWriter::Impl::check_frame(const PendingFrame& frame) const {
  const FrameForm& form = info.form;
  HAARLIGHT_EXPECTS(frame.shot >= 0 && static_cast<std::size_t>(frame.shot) < info.shots.size(),
                    "a shot of the plan");
  HAARLIGHT_EXPECTS(frame.attempt >= 0, "an attempt from 0 up");
  HAARLIGHT_EXPECTS(form.sample == SampleType::u16 && frame.pixels.width() == form.width &&
                        frame.pixels.height() == form.stored_height &&
                        frame.pixels.channels() == form.channels,
                    "a frame of the session's form");
  if (rows.find({frame.shot, frame.attempt}) != rows.end()) {
    return fail(Errc::refused,
                fmt::format("shot {} attempt {} has a row already", frame.shot, frame.attempt));
  }
  const ImageView<const std::uint16_t> active(frame.pixels.data(), form.height, form.width,
                                              form.channels, frame.pixels.row_stride());
  if (hash_pixels(active) != frame.evidence.pixel_hash) {
    return fail(Errc::protocol,
                fmt::format("shot {}: the pixels are not those that were checked: their hash "
                            "differs from the evidence",
                            frame.shot));
  }
  if (const std::string problem = find_evidence_problem(frame.evidence); !problem.empty()) {
    return fail(Errc::refused, fmt::format("shot {}: {}", frame.shot, problem));
  }
  return {};
}

std::vector<FrameRecord> SessionWriter::Impl::frame_records() const {
  std::map<int, FrameRecord> newest;
  for (const auto& [key, row] : rows) {
    if (row.state == RowState::committed) {
      newest[row.shot] = {row.shot,
                          row.attempt,
                          row.file,
                          row.file_hash,
                          evidence_from_json(row.evidence, row.file),
                          leaves.at(key)};
    }
  }
  std::vector<FrameRecord> records;
  records.reserve(newest.size());
  for (auto& [shot, record] : newest) {
    records.push_back(std::move(record));
  }
  return records;
}

SessionWriter::SessionWriter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SessionWriter::~SessionWriter() = default;
SessionWriter::SessionWriter(SessionWriter&&) noexcept = default;
SessionWriter& SessionWriter::operator=(SessionWriter&&) noexcept = default;

bool SessionWriter::discard_unmade(const fs::path& folder, Storage& storage) {
  std::error_code error;
  if (fs::symlink_status(folder, error).type() != fs::file_type::directory) {
    return false;
  }
  std::vector<fs::path> made;
  bool has_reserve = false;
  for (fs::directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().filename().string();
    if (name == "frames" || name == "aside") {
      continue;  // empty, or below they stay
    }
    const bool is_ours = name == kReserve || name == "rig.toml" || name == "plan.json" ||
                         name.rfind(kJournal, 0) == 0 ||
                         it->path().extension().string().rfind(".new", 0) == 0;
    if (!is_ours) {
      return false;
    }
    has_reserve = has_reserve || name == kReserve || name.rfind(kJournal, 0) == 0;
    made.push_back(it->path());
  }
  const auto is_bare = [&](const char* name) {
    std::error_code ignored;
    return !fs::exists(folder / name, ignored) || fs::is_empty(folder / name, ignored);
  };
  if (error || !has_reserve || !is_bare("frames") || !is_bare("aside")) {
    return false;
  }
  for (const fs::path& file : made) {
    if (!storage.remove(file)) {
      return false;
    }
  }
  for (const fs::path& empty : {folder / "frames", folder / "aside", folder}) {
    fs::remove(empty, error);  // refuses one that is not empty
  }
  return !fs::exists(folder, error);
}

Result<SessionWriter> SessionWriter::create(const fs::path& folder, const SessionInfo& info,
                                            const std::string& rig_toml,
                                            const std::string& plan_json,
                                            std::uint64_t reserve_bytes, Storage& storage) {
  std::error_code ignored;
  const bool is_new = !fs::exists(folder, ignored);
  auto made = make(folder, info, rig_toml, plan_json, reserve_bytes, storage);
  if (!made && is_new && !discard_unmade(folder, storage)) {
    for (const fs::path& empty : {folder / "frames", folder / "aside", folder}) {
      fs::remove(empty, ignored);
    }
  }
  return made;
}

Result<SessionWriter> SessionWriter::make(const fs::path& folder, const SessionInfo& info,
                                          const std::string& rig_toml,
                                          const std::string& plan_json,
                                          std::uint64_t reserve_bytes, Storage& storage) {
  HAARLIGHT_EXPECTS(info.frames.empty(), "a new session without frames");
  HAARLIGHT_EXPECTS(!info.id.empty(), "a session with an id");
  std::error_code ignored;
  if (fs::exists(folder / kStart, ignored) || fs::exists(folder / "session.json", ignored) ||
      (fs::exists(folder / "frames", ignored) && !fs::is_empty(folder / "frames", ignored))) {
    return fail(Errc::refused, folder.string() + ": a session is there already; reopen it");
  }
  if (!info.rig_hash.empty() && info.rig_hash != content_hash(rig_toml)) {
    return fail(Errc::refused, "the rig's hash is not that of the rig file given");
  }
  for (const fs::path& made : {folder, folder / "frames", folder / "aside"}) {
    if (auto done = make_folder(made); !done) {
      return pass_on(done);
    }
  }
  const auto free = storage.free_bytes(folder);
  if (!free) {
    return pass_on(free);
  }
  if (*free < reserve_bytes) {
    return fail(Errc::no_space, fmt::format("{}: {} bytes free, the plan needs {}",
                                            folder.string(), *free, reserve_bytes));
  }
  auto impl = std::make_unique<Impl>();
  impl->folder = folder;
  impl->storage = &storage;
  impl->info = info;
  impl->info.plan_file_hash = content_hash(plan_json);
  impl->info.program = program_name();
  impl->setup = setup_hash(impl->info);
  impl->plan = plan_json;
  impl->committed.assign(info.shots.size(), false);
  impl->next_attempt.assign(info.shots.size(), 0);
  bool is_reserved = reserve_bytes > 0;
  if (is_reserved) {
    const auto reserved = storage.reserve(folder / kReserve, reserve_bytes);
    if (!reserved && reserved.error().code != Errc::unsupported) {
      (void)storage.remove(folder / kReserve);
      return pass_on(reserved);
    }
    is_reserved = reserved.has_value();
    impl->reserved = is_reserved ? reserve_bytes : 0;
  }
  // An interrupted creation leaves temporary files and a journal without rows.
  if (auto done = impl->sweep_temporaries(); !done) {
    return pass_on(done);
  }
  if (auto done = impl->open_journal(); !done) {
    return pass_on(done);
  }
  if (!is_reserved && reserve_bytes > 0) {
    if (auto id = impl->journal->log(
            EventKind::not_reserved,
            reason_json(folder.string(), "this file system cannot reserve space"));
        !id) {
      return pass_on(id);
    }
  }
  // start.json comes last: a folder that has it is complete.
  if (!rig_toml.empty()) {
    if (auto done = impl->write_durably(folder / "rig.toml", rig_toml); !done) {
      return pass_on(done);
    }
  }
  if (auto done = impl->write_durably(folder / "plan.json", plan_json); !done) {
    return pass_on(done);
  }
  if (auto done = impl->write_durably(folder / kStart, session_info_to_json(impl->info));
      !done) {
    return pass_on(done);
  }
  const fs::path parent = folder.has_parent_path() ? folder.parent_path() : fs::path(".");
  if (auto done = storage.sync_folder(parent); !done) {
    return pass_on(done);
  }
  return SessionWriter(std::move(impl));
}

Result<SessionWriter> SessionWriter::reopen(const fs::path& folder, Storage& storage) {
  auto impl = std::make_unique<Impl>();
  impl->folder = folder;
  impl->storage = &storage;
  std::error_code ignored;
  if (!fs::exists(folder / kStart, ignored)) {
    return fail(Errc::refused,
                folder.string() +
                    ": start.json is missing: the session was never wholly made; "
                    "create it again");
  }
  try {
    const fs::path start = folder / kStart;
    impl->info = session_info_from_json(read_file(start, kMaxText), start.string());
    impl->info.frames.clear();
    impl->plan = read_file(folder / "plan.json", kMaxText);
    if (content_hash(impl->plan) != impl->info.plan_file_hash) {
      return fail(Errc::protocol, (folder / "plan.json").string() +
                                      ": altered since the session was made: its hash differs");
    }
  } catch (const Error& error) {
    return fail(error.code() == ExitCode::io ? Errc::io : Errc::protocol, error.what());
  }
  impl->setup = setup_hash(impl->info);
  impl->committed.assign(impl->info.shots.size(), false);
  impl->next_attempt.assign(impl->info.shots.size(), 0);
  for (const fs::path& made : {impl->frames(), impl->aside()}) {
    if (auto done = make_folder(made); !done) {
      return pass_on(done);
    }
  }
  for (fs::directory_iterator it(impl->aside(), ignored), end; !ignored && it != end;
       it.increment(ignored)) {
    int shot = 0;
    int attempt = 0;
    const std::string name = it->path().filename().string();
    if (parse_frame_file_name(name.substr(0, name.find(".tif") + 4), shot, attempt)) {
      impl->note_attempt(shot, attempt);
    }
  }
  const auto reserve_size = fs::file_size(folder / kReserve, ignored);
  impl->reserved = ignored ? 0 : reserve_size;
  auto done = impl->sweep_temporaries();
  if (done) {
    done = impl->open_journal();
  }
  if (done) {
    done = impl->note_rebuilding();
  }
  if (done) {
    done = impl->check_rows();
  }
  if (done) {
    done = impl->adopt_frames();
  }
  if (done) {
    done = impl->note_events_of_aside();
  }
  if (!done) {
    return pass_on(done);
  }
  return SessionWriter(std::move(impl));
}

const SessionInfo& SessionWriter::info() const { return impl_->info; }
const RecoveryReport& SessionWriter::recovery() const { return impl_->recovery; }
const std::vector<bool>& SessionWriter::committed() const { return impl_->committed; }
const std::string& SessionWriter::plan_json() const { return impl_->plan; }

std::vector<std::pair<int, FrameEvidence>> SessionWriter::committed_evidence() const {
  std::vector<std::pair<int, FrameEvidence>> found;
  for (const auto& [key, row] : impl_->rows) {
    if (row.state == RowState::committed) {
      found.emplace_back(row.shot, evidence_from_json(row.evidence, row.file));
    }
  }
  return found;
}

int SessionWriter::next_attempt(int shot) const {
  return impl_->next_attempt.at(static_cast<std::size_t>(shot));
}

Result<void> SessionWriter::commit(std::span<const PendingFrame> frames) {
  Impl& impl = *impl_;
  if (!impl.journal) {
    return fail(Errc::refused, "the session is finished; reopen it to take more shots");
  }
  for (const PendingFrame& frame : frames) {
    if (auto good = impl.check_frame(frame); !good) {
      return good;
    }
  }
  std::vector<JournalRow> rows;
  rows.reserve(frames.size());
  for (const PendingFrame& frame : frames) {
    const std::string description = frame_description_to_json(
        describe_frame(impl.info, impl.setup, frame.shot, frame.attempt, frame.evidence));
    const std::vector<std::byte> bytes = encode_frame_tiff(frame.pixels, description);
    const std::string name = frame_file_name(frame.shot, frame.attempt);
    impl.shrink_reserve(bytes.size());
    if (auto done = impl.write_renamed(impl.folder / name, bytes); !done) {
      return done;
    }
    rows.push_back({frame.shot, frame.attempt, name, content_hash(bytes),
                    evidence_to_json(frame.evidence), RowState::committed});
    impl.leaves[{frame.shot, frame.attempt}] = to_hex(leaf_hash(name, bytes));
  }
  if (auto done = impl.storage->sync_folder(impl.frames()); !done) {
    return done;
  }
  if (auto done = impl.journal->insert(rows); !done) {
    return done;
  }
  for (const JournalRow& row : rows) {
    impl.note_row(row);
  }
  return {};
}

Result<void> SessionWriter::keep_refused(const PendingFrame& frame, const std::string& reason) {
  Impl& impl = *impl_;
  if (!impl.journal) {
    return fail(Errc::refused, "the session is finished; its journal is closed");
  }
  if (auto good = impl.check_frame(frame); !good) {
    return good;
  }
  const std::string description = frame_description_to_json(
      describe_frame(impl.info, impl.setup, frame.shot, frame.attempt, frame.evidence));
  const std::string name =
      fs::path(frame_file_name(frame.shot, frame.attempt)).filename().string();
  const fs::path note = impl.aside() / (name + ".why.txt");
  const std::string text =
      fmt::format("{}: {}: {}\n", name, to_string(frame.evidence.verdict), reason);
  // The reason first: no frame is ever in aside/ without one.
  if (auto done = impl.write_renamed(note, std::as_bytes(std::span(text))); !done) {
    return done;
  }
  if (auto done =
          impl.write_renamed(impl.aside() / name, encode_frame_tiff(frame.pixels, description));
      !done) {
    return done;
  }
  if (auto done = impl.storage->sync_folder(impl.aside()); !done) {
    return done;
  }
  impl.note_attempt(frame.shot, frame.attempt);
  const auto id = impl.journal->log(EventKind::refused, reason_json("aside/" + name, reason));
  return id ? Result<void>() : pass_on(id);
}

Result<void> SessionWriter::withdraw(int shot, const std::string& reason) {
  Impl& impl = *impl_;
  HAARLIGHT_EXPECTS(shot >= 0 && static_cast<std::size_t>(shot) < impl.info.shots.size(),
                    "a shot of the plan");
  if (!impl.journal) {
    return fail(Errc::refused, "the session is finished; reopen it to withdraw a shot");
  }
  for (auto it = impl.rows.lower_bound({shot, 0});
       it != impl.rows.end() && it->first.first == shot; ++it) {
    JournalRow& row = it->second;
    if (row.state != RowState::committed) {
      continue;
    }
    if (auto done = impl.set_session_json_aside("a shot is taken again"); !done) {
      return done;
    }
    // The note outlives the journal: a rebuild must not bring the frame back.
    const fs::path note =
        impl.aside() / fmt::format("{:06}_a{}.withdrawn.txt", row.shot, row.attempt);
    if (auto done = impl.write_durably(note, reason + "\n"); !done) {
      return done;
    }
    if (auto id = impl.journal->log(EventKind::withdrawn, reason_json(row.file, reason)); !id) {
      return pass_on(id);
    }
    if (auto done = impl.journal->set_state(row.shot, row.attempt, RowState::withdrawn);
        !done) {
      return done;
    }
    row.state = RowState::withdrawn;
  }
  impl.refresh_committed(shot);
  return {};
}

Result<std::int64_t> SessionWriter::log_event(EventKind kind, const std::string& json) {
  if (!impl_->journal) {
    return fail(Errc::refused, "the session is finished; its journal is closed");
  }
  return impl_->journal->log(kind, json);
}

Result<std::vector<JournalEvent>> SessionWriter::events_after(std::int64_t id,
                                                              int limit) const {
  if (!impl_->journal) {
    return fail(Errc::refused, "the session is finished; its journal is closed");
  }
  return impl_->journal->events_after(id, limit);
}

bool SessionWriter::is_finished() const { return !impl_->journal.has_value(); }

Result<void> SessionWriter::finish() {
  Impl& impl = *impl_;
  const auto missing = std::find(impl.committed.begin(), impl.committed.end(), false);
  if (missing != impl.committed.end()) {
    return fail(Errc::refused,
                fmt::format("{} shots are not committed, the first is {}",
                            std::count(impl.committed.begin(), impl.committed.end(), false),
                            missing - impl.committed.begin()));
  }
  if (impl.journal) {
    if (auto done = impl.sweep_orphans(); !done) {
      return done;
    }
    if (auto id = impl.journal->log(EventKind::finished, "{}"); !id) {
      return pass_on(id);
    }
    auto text = impl.journal->text();
    if (!text) {
      return pass_on(text);
    }
    impl.journal_text = std::move(*text);
    if (auto done = impl.journal->close_for_archive(); !done) {
      return done;
    }
    impl.journal.reset();
  }
  impl.reserved = 0;
  if (auto done = impl.storage->remove(impl.folder / kReserve); !done) {
    return done;
  }
  SessionInfo info = impl.info;
  info.frames = impl.frame_records();
  info.made_by = impl.is_rebuilt ? MadeBy::rebuild : MadeBy::capture;
  try {
    seal_session(impl.folder, impl.journal_text, info);
  } catch (const Error& error) {
    return fail(Errc::io, error.what());
  }
  return impl.write_durably(impl.folder / "session.json", session_info_to_json(info));
}

}  // namespace haarlight::session
