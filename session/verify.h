#pragma once

#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "core/progress.h"
#include "session/session_writer.h"
#include "session/storage.h"

/// @file
/// Re-checks every promise of a finished session, years later, and rebuilds its journal and
/// session.json from the frames.

namespace haarlight {

struct VerifyReport {
  int n_shots = 0;
  int n_frames = 0;      ///< frames that were read and hold
  int n_by_word = 0;     ///< measured frames whose light rests on controller and clock alone
  int n_by_picture = 0;  ///< and those whose own pixels prove it besides
  int n_suspect = 0;     ///< committed frames whose verdict is not good
  double least_margin_us = std::numeric_limits<double>::infinity();  ///< of measured frames
  std::vector<std::string> problems;  ///< "file: what", a broken promise each
  std::vector<std::string> notes;     ///< worth knowing, nothing broken
  [[nodiscard]] bool is_good() const { return problems.empty(); }
};

/// Checks plan and rig hashes; that every shot has its frame; of every frame the file's hash,
/// the pixels' hash and statistics, that it says what session.json says, and the clean rule
/// computed again from its stamps; that no frame was used twice and no two frames with
/// unclipped noise have the same pixels; and that the journal agrees. Reads every byte once;
/// changes nothing.
/// @throws Error  session.json is missing or cannot be read
[[nodiscard]] VerifyReport verify_session(const std::filesystem::path& folder,
                                          ProgressStyle progress = ProgressStyle::none);

struct RebuildReport {
  RecoveryReport recovery;
  int n_shots = 0;
  int n_pending = 0;  ///< shots without a good frame: 0 means session.json was written
};

/// Sets the journal aside, makes a new one of the frames that hold, and writes session.json
/// when every shot has one. Frames that do not hold go to aside/ with the reason.
/// @throws Error  neither start.json nor session.json can be read; a fault of the disk
[[nodiscard]] RebuildReport rebuild_session(const std::filesystem::path& folder,
                                            Storage& storage);

}  // namespace haarlight
