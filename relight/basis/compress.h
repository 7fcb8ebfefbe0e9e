#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <string>

#include "core/image_io.h"
#include "core/progress.h"
#include "relight/basis/basis_file.h"
#include "relight/basis/stack_source.h"

/// @file
/// Light stack to basis file within a stated error. Method: docs/numerics/relight.md, "The
/// coder". Three passes over the stack, tile by tile: (1) norms, plate gains; (2) a histogram
/// of the residual's coefficients, which predicts the error of every quantiser step; (3) coding
/// with the step chosen, the error measured on what was coded. A pixel whose own error exceeds
/// its bound gets half the step, again and again, so that dark pixels are not erased.

namespace haarlight {

struct CompressOptions {
  double relative_l2 = 0.01;  ///< 0: exact, the stack's floats bit for bit
  /// Bound on each pixel's own relative error (StackError::worst_pixel).
  double worst_pixel = std::numeric_limits<double>::infinity();
  BasisKind basis = BasisKind::haar;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
  ProgressStyle progress = ProgressStyle::none;
  /// As DevelopOptions::unknown_as, where a session is developed on the way.
  std::optional<Transfer> unknown_as{};
};

/// Where the stack comes from and what lit it.
struct CompressSource {
  const StackSource* stack = nullptr;
  const StackSource* plate = nullptr;  ///< 1 channel, or the stack's; none: no plate
  std::string plate_kind = "none";     ///< computed, captured, itself
  std::string plate_source;
  int grid = 0;  ///< n where the lights form n x n grids, n a power of two; else 0
  std::string rig_toml;
  std::string rig_hash;
  std::vector<BasisLight> lights;  ///< where there is no rig
  std::string name;
  std::string hash;
  std::string kind = "capture";
};

struct CompressSummary {
  BasisHeader header;             ///< as written; `reached` is measured on the coded data
  std::uint64_t bytes = 0;        ///< of the file
  std::uint64_t bytes_moved = 0;  ///< read from the stack, all passes
  double worst_light = 0.0;       ///< largest relative L2 error of one light's picture
  [[nodiscard]] bool is_reached() const {
    return header.reached.relative_l2 <= header.asked_relative_l2 &&
           header.reached.worst_pixel <= header.asked_worst_pixel;
  }
};

/// Writes `file`, whole or not at all. Deterministic: same input, same bytes, any threads.
/// @throws Error  a Haar basis of lights that form no grid (names --basis direct), NaN or
///                infinity (names light and pixel), a plate of another shape, too little memory
[[nodiscard]] CompressSummary compress_stack(const CompressSource& source,
                                             const std::filesystem::path& file,
                                             const CompressOptions& options);

}  // namespace haarlight
