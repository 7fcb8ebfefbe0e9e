// SPDX-License-Identifier: Apache-2.0
#include <set>

#include <fmt/format.h>

#include "core/sha256.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "session/frame_tiff.h"
#include "session/seal.h"
#include "session/signature.h"
#include "session/verify_checks.h"

namespace haarlight::session {

namespace {

namespace fs = std::filesystem;

/// Top-level names of a session; of these only cache/ is not followed.
const std::set<std::string> kOwnNames = {
    "start.json", "session.json", kSignatureFile,   "plan.json",   "rig.toml",
    "frames",     "aside",        "journal.sqlite", "aborted.txt", "cache"};

/// A session's bytes are in its own files: links lead outside of what was hashed and signed.
void check_kinds(const fs::path& folder, VerifyReport& report) {
  std::set<std::string> problems;
  std::set<std::string> notes;
  std::error_code error;
  for (fs::recursive_directory_iterator it(folder, error), end; !error && it != end;
       it.increment(error)) {
    const std::string name = it->path().lexically_relative(folder).generic_string();
    std::error_code ignored;
    const fs::file_status status = fs::symlink_status(it->path(), ignored);
    if (name == "cache" && fs::is_directory(status)) {
      it.disable_recursion_pending();
      continue;
    }
    if (it.depth() == 0 && kOwnNames.count(name) == 0) {
      it.disable_recursion_pending();
      const bool is_of_sqlite = name.rfind("journal.sqlite", 0) == 0;
      (is_of_sqlite ? problems : notes)
          .insert(name + (is_of_sqlite ? ": the journal was not closed for the archive"
                                       : ": not part of the session, not checked"));
      continue;
    }
    if (fs::is_directory(status)) {
      if (it.depth() > 0) {
        problems.insert(name + ": a folder, where a session has files only");
      }
    } else if (!fs::is_regular_file(status)) {
      problems.insert(name + ": a link or no plain file: its bytes are not in the session");
    } else if (fs::hard_link_count(it->path(), ignored) > 1 && !ignored) {
      notes.insert(name +
                   ": has another name elsewhere (hard link): who changes that changes "
                   "this");
    }
  }
  if (error) {
    problems.insert("cannot be listed: " + error.message());
  }
  report.problems.insert(report.problems.end(), problems.begin(), problems.end());
  report.notes.insert(report.notes.end(), notes.begin(), notes.end());
}

void check_files(const fs::path& folder, const SessionInfo& info, VerifyReport& report) {
  std::set<std::string> listed;
  for (const SealedFile& file : info.files) {
    if (!listed.insert(file.name).second) {
      report.problems.push_back(file.name + ": listed twice in session.json");
    }
  }
  std::set<std::string> present;
  for (const std::string& name : list_sealed_names(folder, info)) {
    present.insert(name);
    int shot = 0;
    int attempt = 0;
    const bool is_said =
        name.rfind("frames/", 0) == 0 && !parse_frame_file_name(name.substr(7), shot, attempt);
    if (listed.count(name) == 0 && !is_said) {
      report.problems.push_back(name + ": appeared after the session was finished");
    }
  }
  for (const SealedFile& file : info.files) {
    if (file.name == "journal.sqlite") {
      continue;  // by its content, with the journal's other checks
    }
    if (present.count(file.name) == 0) {
      report.problems.push_back(file.name + ": missing, session.json lists it");
    } else if (to_hex(leaf_hash(file.name, MappedFile(folder / file.name).bytes())) !=
               file.sha256) {
      report.problems.push_back(file.name +
                                ": altered after the session was finished: SHA-256 differs");
    }
  }
}

void check_root(const std::string& json, const SessionInfo& info, VerifyReport& report) {
  report.root = info.root;
  const std::string_view part = sealed_part(json);
  if (part.empty()) {
    report.problems.emplace_back("session.json: its root is not where it belongs, at its end");
    return;
  }
  if (root_of(part, info) != info.root) {
    report.problems.emplace_back(
        "session.json: altered after it was written: its root is of other bytes");
  }
}

void check_signed(const fs::path& folder, const fs::path& signers, VerifyReport& report) {
  std::error_code ignored;
  if (!fs::exists(folder / kSignatureFile, ignored)) {
    if (!signers.empty()) {
      report.problems.push_back(fmt::format(
          "{}: missing: nobody signed this session, or the signature was taken away",
          kSignatureFile));
    } else {
      report.notes.emplace_back(
          "not signed: accident and careless editing are found, a forger who computes the "
          "root again is not");
    }
    return;
  }
  const SignatureCheck check = check_signature(folder, signers);
  if (!check.is_good) {
    report.problems.push_back(fmt::format("{}: {}", kSignatureFile, check.said));
  } else if (signers.empty()) {
    report.notes.push_back(check.said + "; whose it is was not checked (--signers)");
  } else {
    report.signed_by = check.said;
  }
}

}  // namespace

void check_seal(const fs::path& folder, const std::string& json, const SessionInfo& info,
                const fs::path& signers, VerifyReport& report) {
  check_kinds(folder, report);
  if (info.root.empty()) {
    if (!info.program.empty() || !info.files.empty()) {
      report.problems.emplace_back("session.json: its root was taken away");
    } else {
      report.notes.emplace_back(
          "an older program's session: it has no root over its bytes, and its frames do not "
          "say what was lit");
    }
  } else {
    try {
      check_files(folder, info, report);
      check_root(json, info, report);
    } catch (const Error& error) {
      report.problems.push_back(fmt::format("{}: {}", error.where(), error.problem()));
    }
    if (info.made_by == MadeBy::rebuild) {
      report.notes.emplace_back(
          "session.json: made by haarlight rebuild from the frames, not by the capture");
    }
  }
  check_signed(folder, signers, report);
}

}  // namespace haarlight::session
