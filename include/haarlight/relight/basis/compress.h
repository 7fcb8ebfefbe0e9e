// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/basis_file.h"

/// @file
/// Light stack to basis file within a stated error. Method: docs/numerics/relight.md, "The
/// coder". A sample of the picture's rows (all of them where it is small) predicts the error of
/// every quantiser step; one pass then codes the tiles with the chosen step and measures the
/// error on what was coded. A pixel whose own error exceeds its bound gets half the step,
/// repeatedly, so that dark pixels are not erased.
///
/// Coded tile rows are kept in FILE.part/ until the file is complete: a killed compression
/// resumes where it stopped, and several processes can share one job. The bytes depend neither
/// on that nor on threads and memory.

namespace haarlight::relight {

/// One of several processes that compress one stack together into a file that all can access.
struct Rank {
  int i = 0;
  int n = 1;
  /// Returns when every process has arrived here. @throws Error  one of them is lost
  std::function<void()> wait_for_all = [] {};
};

struct CompressOptions {
  double relative_l2 = 0.01;  ///< 0: exact, the stack's floats bit for bit
  /// Bound on each pixel's own relative error (StackError::worst_pixel).
  double worst_pixel = std::numeric_limits<double>::infinity();
  /// Instead of an error: CompressSource::units, every value's nearest multiple exactly.
  bool is_integer = false;
  BasisKind basis = BasisKind::haar;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  ProgressStyle progress = ProgressStyle::none;
  /// As DevelopOptions::unknown_as, where a session is developed in the process.
  std::optional<Transfer> unknown_as{};
  Rank rank{};
};

/// Where the stack comes from and what lit it.
struct CompressSource {
  const StackSource* stack = nullptr;
  RowSource* rows = nullptr;           ///< the stack again, where its rows must be loaded first
  const StackSource* plate = nullptr;  ///< 1 channel, or the stack's; none: no clean plate
  PlateOrigin plate_origin = PlateOrigin::none;
  std::string plate_source;
  /// (n_lights): one camera quantisation step in the stack's values; empty where there is none.
  std::vector<double> units;
  HaarGrid grid;  ///< of each face, where the lights form grids; else 0 x 0
  std::string rig_toml;
  std::string rig_hash;
  std::vector<BasisLight> lights;  ///< where there is no rig
  std::string name;                ///< for the file: name of the capture
  std::string location;            ///< for errors: its location
  std::string hash;
  std::string root;
  PictureFacts photographed;
  BasisContent content = BasisContent::capture;
  /// Hash of everything that the values of stack and plate depend on. Empty: not known, and
  /// nothing is kept of an unfinished compression.
  std::string key;
};

struct CompressSummary {
  BasisHeader header;       ///< as written; the achieved error is measured on the coded data
  std::uint64_t bytes = 0;  ///< of the file
  std::uint64_t bytes_moved = 0;  ///< values read from the stack by this process, all passes
  int n_rows_found = 0;           ///< tile rows that an earlier run had coded already
  double worst_light = 0.0;       ///< largest relative L2 error of one light's picture
  /// For a clean plate not computed pixel by pixel: pixels compared with light_irradiance(),
  /// and the relative L2 error found there. The achieved errors include it twice.
  int n_checked = 0;
  double checked_error = 0.0;
  double seconds_plate = 0.0;    ///< its vectors: the same work on every rank
  double seconds_looked = 0.0;   ///< sampling the values: shared by the ranks
  double seconds_coded = 0.0;    ///< shared by the ranks, waiting for the others included
  double seconds_written = 0.0;  ///< by rank 0: the pieces into the file
  [[nodiscard]] bool is_achieved() const {
    return header.achieved.relative_l2 <= header.requested_relative_l2 &&
           header.achieved.worst_pixel <= header.requested_worst_pixel;
  }
};

/// Writes `file`, completely or not at all. Deterministic: same input, same bytes, whatever the
/// threads, ranks, memory and interruptions. With several ranks, rank 0 writes the file; all
/// return the same summary except for what each moved itself.
/// @throws Error  integers for a stack without units, or values beyond 2^24 units; a Haar basis
///                of lights that form no grid (names --basis direct), NaN or infinity (names
///                light and pixel), a plate of another shape, too little memory, the disk full
///                (a rerun resumes)
[[nodiscard]] CompressSummary compress_stack(const CompressSource& source,
                                             const std::filesystem::path& file,
                                             const CompressOptions& options);

}  // namespace haarlight::relight
