// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "haarlight/core/progress.h"
#include "session/session_writer.h"
#include "session/storage.h"

/// @file
/// Re-checks every guarantee of a finished session, years later, and rebuilds its journal and
/// session.json from the frames.

namespace haarlight::session {

struct VerifyReport {
  int n_shots = 0;
  int n_frames = 0;      ///< frames that were read and are valid
  int n_by_word = 0;     ///< measured frames attested by controller and clock alone
  int n_by_picture = 0;  ///< and those whose own pixels prove it as well
  int n_suspect = 0;     ///< committed frames whose verdict is not good
  double least_margin_us = std::numeric_limits<double>::infinity();  ///< of measured frames
  std::string root;                   ///< of session.json, as written there; empty: it has none
  std::string signed_by;              ///< what ssh-keygen reports about an allowed signer
  std::vector<std::string> problems;  ///< "file: what", each a broken guarantee
  std::vector<std::string> notes;     ///< worth knowing, nothing broken
  [[nodiscard]] bool is_good() const { return problems.empty(); }
};

/// Checks plan and rig hashes and compares session.json with both; that every shot has its
/// frame; for every frame the file's hashes, the pixels' hash and statistics, that it agrees
/// with session.json (including what was lit), and the clean rule recomputed from its
/// timestamps; that no frame was used twice and no two frames with unclipped noise have the
/// same pixels; that the journal agrees; that there are no links and no files added later; the
/// root, and the signature where there is one. Reads every byte, the frames' once; changes
/// nothing.
///
/// Unsigned this reveals accidents and careless editing, signed every change after signing.
/// @param signers  ssh-keygen's allowed_signers: the session must be signed by one of these;
///                 empty: it need not be signed
/// @throws Error  session.json is missing or cannot be read; the signers' file is missing;
///                ssh-keygen is needed and missing
[[nodiscard]] VerifyReport verify_session(const std::filesystem::path& folder,
                                          ProgressStyle progress = ProgressStyle::none,
                                          const std::filesystem::path& signers = {});

struct RebuildReport {
  RecoveryReport recovery;
  int n_shots = 0;
  int n_pending = 0;  ///< shots without a good frame: 0 means session.json was written
};

/// Sets the journal, session.json and its signature aside, makes a new journal of the valid
/// frames, and writes session.json when every shot has one: marked as made by rebuild, with the
/// mark under its root, and never signed. Invalid frames go to aside/ with the reason.
/// @throws Error  neither start.json nor session.json can be read; a disk fault
[[nodiscard]] RebuildReport rebuild_session(const std::filesystem::path& folder,
                                            Storage& storage);

}  // namespace haarlight::session
