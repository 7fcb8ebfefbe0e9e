// SPDX-License-Identifier: Apache-2.0
#include "session/verify.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/clean_rule.h"
#include "session/frame_check.h"
#include "session/signature.h"
#include "session/verify_checks.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMaxText = std::uintmax_t{1} << 30U;

std::string find_frame_problem(const fs::path& folder, const SessionInfo& info,
                               const FrameRecord& frame) {
  const fs::path file = folder / frame.file;
  std::error_code ignored;
  if (!fs::exists(fs::symlink_status(file, ignored))) {
    return "missing";
  }
  if (frame.file != frame_file_name(frame.shot, frame.attempt)) {
    return fmt::format("is not named after shot {} attempt {}", frame.shot, frame.attempt);
  }
  const FrameInspection inspection = inspect_frame(file, info);
  if (inspection.file_hash.empty()) {
    return inspection.problem;
  }
  if (inspection.file_hash != frame.file_hash) {
    return "altered: the file's hash differs from session.json";
  }
  if (!info.root.empty() && inspection.sha256 != frame.sha256) {
    return "altered: the file's SHA-256 differs from session.json";
  }
  if (!inspection.is_good()) {
    return inspection.problem;
  }
  if (inspection.description.shot != frame.shot ||
      inspection.description.attempt != frame.attempt) {
    return fmt::format("says it is shot {} attempt {}", inspection.description.shot,
                       inspection.description.attempt);
  }
  if (!(inspection.description.evidence == frame.evidence)) {
    return "its evidence differs from session.json";
  }
  const FrameEvidence& e = frame.evidence;
  const Shot& shot = info.shots[static_cast<std::size_t>(frame.shot)];
  if (e.kind == EvidenceKind::measured && e.pattern_id != frame.shot) {
    return fmt::format("its evidence is of pattern {}, not {}", e.pattern_id, frame.shot);
  }
  if (e.kind == EvidenceKind::measured && shot.exposure_us > 0.0 &&
      e.exposure_requested_us != shot.exposure_us) {
    return fmt::format("{} us were requested of the camera, the shot has {}",
                       e.exposure_requested_us, shot.exposure_us);
  }
  return {};
}

/// A frame used twice, and equal pixels where unclipped noise must differ.
void check_duplicates(const SessionInfo& info, VerifyReport& report) {
  std::map<std::pair<std::uint64_t, std::int64_t>, const FrameRecord*> by_timestamp;
  std::map<std::string, const FrameRecord*> by_pixels;
  for (const FrameRecord& frame : info.frames) {
    const FrameEvidence& e = frame.evidence;
    if (e.kind != EvidenceKind::asserted) {
      const auto [it, is_new] =
          by_timestamp.emplace(std::pair(e.sequence, e.timestamp_ns), &frame);
      if (!is_new) {
        report.problems.push_back(
            fmt::format("{}: the camera's frame {} stands for shot {} as well", frame.file,
                        e.sequence, it->second->shot));
      }
    }
    const ShotKind kind = info.shots[static_cast<std::size_t>(frame.shot)].kind;
    const bool may_coincide = info.form.sample == SampleType::u8 && kind == ShotKind::dark;
    const bool has_noise = 1.0 - e.saturated_fraction - e.black_fraction > 0.0;
    if (may_coincide || !has_noise) {
      continue;
    }
    const auto [it, is_new] = by_pixels.emplace(e.pixel_hash, &frame);
    if (!is_new) {
      report.problems.push_back(fmt::format("{}: the same pixels as {}: one frame saved twice",
                                            frame.file, it->second->file));
    }
  }
}

/// In order of the timestamps the camera's frame number increases; where it falls back the
/// camera (or the machine) was restarted, which is worth knowing.
void check_sequence(const SessionInfo& info, VerifyReport& report) {
  std::vector<const FrameRecord*> frames;
  for (const FrameRecord& frame : info.frames) {
    if (frame.evidence.kind != EvidenceKind::asserted) {
      frames.push_back(&frame);
      report.least_margin_us = std::min(report.least_margin_us, frame.evidence.margin_us);
    }
  }
  std::sort(frames.begin(), frames.end(), [](const FrameRecord* a, const FrameRecord* b) {
    return a->evidence.timestamp_ns < b->evidence.timestamp_ns;
  });
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const FrameEvidence& before = frames[i - 1]->evidence;
    const FrameEvidence& after = frames[i]->evidence;
    if (after.sequence <= before.sequence) {
      report.notes.push_back(fmt::format(
          "{}: frame number {} after {} ({}): the camera was started again in between",
          frames[i]->file, after.sequence, before.sequence, frames[i - 1]->file));
    } else if (after.t_exposure_start_ns < before.t_exposure_end_ns &&
               after.sync != SyncMode::camera_leads) {
      report.problems.push_back(
          fmt::format("{}: exposed while {} still was", frames[i]->file, frames[i - 1]->file));
    }
  }
}

void check_strays(const fs::path& folder, const SessionInfo& info, VerifyReport& report) {
  std::set<std::string> listed;
  for (const FrameRecord& frame : info.frames) {
    listed.insert(frame.file);
  }
  std::set<std::string> strays;
  std::error_code error;
  for (fs::directory_iterator it(folder / "frames", error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = "frames/" + it->path().filename().string();
    if (listed.count(name) == 0) {
      strays.insert(name);
    }
  }
  for (const std::string& name : strays) {
    int shot = 0;
    int attempt = 0;
    const bool is_older = parse_frame_file_name(name.substr(7), shot, attempt) &&
                          listed.count(frame_file_name(shot, attempt)) == 0;
    (is_older ? report.notes : report.problems)
        .push_back(name + (is_older ? ": an older attempt" : ": not of this session"));
  }
}

/// The earlier frames that later ones of the same lights claim to agree with.
std::set<int> frames_in_agreement(const SessionInfo& info, VerifyReport& report) {
  std::map<int, const FrameRecord*> by_shot;
  for (const FrameRecord& frame : info.frames) {
    by_shot[frame.shot] = &frame;
  }
  std::set<int> agreed;
  for (const FrameRecord& frame : info.frames) {
    const int with = frame.evidence.agrees_with;
    if (with < 0 || with == frame.shot) {
      continue;
    }
    const auto other = by_shot.find(with);
    if (other == by_shot.end() || info.shots[static_cast<std::size_t>(with)].lit !=
                                      info.shots[static_cast<std::size_t>(frame.shot)].lit) {
      report.problems.push_back(
          fmt::format("{}: agrees_with names shot {}, which has other lights: was it altered?",
                      frame.file, with));
    } else if (other->second->evidence.t_exposure_start_ns <
               frame.evidence.t_exposure_start_ns) {
      agreed.insert(with);  // otherwise it was retaken since
    }
  }
  return agreed;
}

/// Attempts that the pixel checks refused, and frames accepted in spite of them.
void note_verdicts(const fs::path& folder, const SessionInfo& info, VerifyReport& report) {
  const std::set<int> agreed = frames_in_agreement(info, report);
  for (const FrameRecord& frame : info.frames) {
    if (frame.evidence.kind != EvidenceKind::asserted) {
      const bool is_proved = frame.evidence.is_picture_proved || agreed.count(frame.shot) > 0;
      ++(is_proved ? report.n_by_picture : report.n_by_word);
    }
    if (frame.evidence.verdict != FrameVerdict::good) {
      ++report.n_suspect;
      report.notes.push_back(fmt::format("{}: {} after attempt {}", frame.file,
                                         to_string(frame.evidence.verdict), frame.attempt));
    }
  }
  std::set<std::string> refused;
  std::error_code error;
  for (fs::directory_iterator it(folder / "aside", error), end; !error && it != end;
       it.increment(error)) {
    int shot = 0;
    int attempt = 0;
    const std::string name = it->path().filename().string();
    if (parse_frame_file_name(name, shot, attempt)) {
      refused.insert(name);
    }
  }
  for (const std::string& name : refused) {
    std::string why = "no reason is kept";
    try {
      why = read_file(folder / "aside" / (name + ".why.txt"), std::uintmax_t{1} << 16U);
      why = why.substr(0, why.find('\n'));
      const std::string prefix = name + ": ";
      why = why.rfind(prefix, 0) == 0 ? why.substr(prefix.size()) : why;
    } catch (const Error&) {  // said by the note
    }
    report.notes.push_back(fmt::format("aside/{}: not used: {}", name, why));
  }
}

template <class T>
T require(Result<T> result) {
  if (!result) {
    const Fault& fault = result.error();
    const bool is_bad_input = fault.code == Errc::protocol || fault.code == Errc::refused;
    throw Error(fault.what, "",
                is_bad_input ? "restore the session from a backup"
                             : "check the disk and its free space",
                is_bad_input ? ExitCode::bad_input : ExitCode::io);
  }
  if constexpr (!std::is_void_v<T>) {
    return std::move(*result);
  }
}

}  // namespace

VerifyReport verify_session(const fs::path& folder, ProgressStyle style,
                            const fs::path& signers) {
  const fs::path file = folder / "session.json";
  std::error_code ignored;
  if (!fs::exists(file, ignored)) {
    (void)Session::open(folder);  // throws with the appropriate hint
  }
  if (!signers.empty() && !fs::is_regular_file(signers, ignored)) {
    throw Error("no such file", signers.string(),
                "name a file of allowed signers: a line \"NAME KEY\" for each (ssh-keygen(1))");
  }
  const std::string json = read_file(file, kMaxText);
  const SessionInfo info = session_info_from_json(json, file.string());
  VerifyReport report;
  report.n_shots = static_cast<int>(info.shots.size());
  check_texts(folder, json, info, report);
  std::vector<bool> has_frame(info.shots.size(), false);
  Progress progress("verify", info.frames.size(), style);
  for (const FrameRecord& frame : info.frames) {
    has_frame[static_cast<std::size_t>(frame.shot)] = true;
    const std::string problem = find_frame_problem(folder, info, frame);
    if (problem.empty()) {
      ++report.n_frames;
    } else {
      report.problems.push_back(frame.file + ": " + problem);
    }
    progress.advance();
  }
  for (std::size_t shot = 0; shot < has_frame.size(); ++shot) {
    if (!has_frame[shot]) {
      report.problems.push_back(fmt::format("shot {}: no frame", shot));
    }
  }
  check_duplicates(info, report);
  check_sequence(info, report);
  check_journal(folder, info, report);
  check_strays(folder, info, report);
  note_verdicts(folder, info, report);
  check_seal(folder, json, info, signers, report);
  return report;
}

RebuildReport rebuild_session(const fs::path& folder, Storage& storage) {
  std::error_code ignored;
  if (!fs::is_directory(folder, ignored)) {
    throw Error("no such folder", folder.string(), "name a session's folder");
  }
  if (!fs::exists(folder / "start.json", ignored)) {
    // An older or damaged session: session.json holds its beginning too.
    const fs::path file = folder / "session.json";
    if (!fs::exists(file, ignored)) {
      throw Error("neither start.json nor session.json is there", folder.string(),
                  "restore one of them from a backup: the frames alone do not tell the lights");
    }
    SessionInfo info = session_info_from_json(read_file(file, kMaxText), file.string());
    info.frames.clear();
    info.files.clear();
    info.root.clear();
    write_file_atomically(folder / "start.json", session_info_to_json(info));
  }
  fs::create_directories(folder / "aside", ignored);
  for (const char* const own :
       {"session.json", kSignatureFile, "journal.sqlite", "journal.sqlite-wal",
        "journal.sqlite-shm", "journal.sqlite-journal"}) {
    const std::string name = own;
    if (!fs::exists(folder / name, ignored)) {
      continue;
    }
    fs::path target = folder / "aside" / name;
    for (int i = 2; fs::exists(target, ignored); ++i) {
      target = folder / "aside" / fmt::format("{}.{}", name, i);
    }
    require(storage.rename(folder / name, target));
    fs::path note = target;
    note += ".why.txt";
    write_file_atomically(note, name + ": set aside by haarlight rebuild\n");
  }
  SessionWriter writer = require(SessionWriter::reopen(folder, storage));
  RebuildReport report;
  report.recovery = writer.recovery();
  report.n_shots = static_cast<int>(writer.committed().size());
  report.n_pending =
      static_cast<int>(std::count(writer.committed().begin(), writer.committed().end(), false));
  if (report.n_pending == 0) {
    require(writer.finish());
  }
  return report;
}

}  // namespace haarlight::session
