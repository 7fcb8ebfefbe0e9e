// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>

#include "core/picture/image_io.h"
#include "core/progress.h"
#include "core/stack/stack_source.h"
#include "relight/basis/basis_file.h"

/// @file
/// Light stack to basis file within a stated error. Method: docs/numerics/relight.md, "The
/// coder". A sample of the picture's rows (all of them where it is small) tells the error of
/// every quantiser step; one pass then codes the tiles with the step chosen and measures the
/// error on what was coded. A pixel whose own error exceeds its bound gets half the step, again
/// and again, so that dark pixels are not erased.
///
/// Coded tile rows are kept in FILE.part/ until the file is whole: a compression that was
/// killed goes on where it was, and several processes share one. The bytes depend neither on
/// that nor on threads and memory.

namespace haarlight {

/// One of several processes that compress one stack together into a file that all can reach.
struct Rank {
  int i = 0;
  int n = 1;
  /// Returns when every process has come here. @throws Error  one of them is lost
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
  /// As DevelopOptions::unknown_as, where a session is developed on the way.
  std::optional<Transfer> unknown_as{};
  Rank rank{};
};

/// Where the stack comes from and what lit it.
struct CompressSource {
  const StackSource* stack = nullptr;
  RowSource* rows = nullptr;           ///< the stack again, where its rows must be loaded first
  const StackSource* plate = nullptr;  ///< 1 channel, or the stack's; none: no plate
  PlateOrigin plate_origin = PlateOrigin::none;
  std::string plate_source;
  /// (n_lights): a step of the camera in the stack's values; empty where they have none.
  std::vector<double> units;
  HaarGrid grid;  ///< of each face, where the lights form grids; else 0 x 0
  std::string rig_toml;
  std::string rig_hash;
  std::vector<BasisLight> lights;  ///< where there is no rig
  std::string name;                ///< for the file: which capture it was
  std::string place;               ///< for errors: where it lies
  std::string hash;
  std::string root;
  PictureFacts photographed;
  BasisContent content = BasisContent::capture;
  /// Hash of everything that the values of stack and plate depend on. Empty: not known, and
  /// nothing is kept of a compression that does not come to its end.
  std::string key;
};

struct CompressSummary {
  BasisHeader header;             ///< as written; `reached` is measured on the coded data
  std::uint64_t bytes = 0;        ///< of the file
  std::uint64_t bytes_moved = 0;  ///< values read from the stack by this process, all passes
  int n_rows_found = 0;           ///< tile rows that an earlier run had coded already
  double worst_light = 0.0;       ///< largest relative L2 error of one light's picture
  /// Of a plate that was not worked through pixel by pixel: pixels compared with
  /// light_irradiance(), and the relative L2 of what they missed. The errors reached hold it
  /// twice.
  int n_checked = 0;
  double checked_error = 0.0;
  double seconds_plate = 0.0;    ///< its vectors: by every rank alike
  double seconds_looked = 0.0;   ///< at a part of the values: shared by the ranks
  double seconds_coded = 0.0;    ///< shared by the ranks, waiting for the others included
  double seconds_written = 0.0;  ///< by rank 0: the pieces into the file
  [[nodiscard]] bool is_reached() const {
    return header.reached.relative_l2 <= header.asked_relative_l2 &&
           header.reached.worst_pixel <= header.asked_worst_pixel;
  }
};

/// Writes `file`, whole or not at all. Deterministic: same input, same bytes, whatever threads,
/// ranks, memory and interruptions. With several ranks rank 0 writes the file; all return the
/// same summary but for what each moved itself.
/// @throws Error  integers of a stack without units, or beyond 2^24 of them; a Haar basis of
/// lights that form no grid (names --basis direct), NaN or
///                infinity (names light and pixel), a plate of another shape, too little
///                memory, the disk full (a rerun goes on)
[[nodiscard]] CompressSummary compress_stack(const CompressSource& source,
                                             const std::filesystem::path& file,
                                             const CompressOptions& options);

}  // namespace haarlight
