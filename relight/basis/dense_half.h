// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/stack/stack_source.h"
#include "relight/basis/huge_page_buffer.h"
#include "relight/basis/light_query.h"
#include "relight/basis/relight_kernels.h"

/// @file
/// A whole light stack in memory as half floats, for repeated relighting: two bytes per value,
/// each tile and channel with its own power of two so that its largest value lies in [2^14,
/// 2^15]. The rounding error of half floats is measured during conversion and is part of every
/// picture's bound. Method and figures: docs/numerics/relight.md, "Kernels".

namespace haarlight::relight {

struct HalfOptions {
  /// 2^exponent is the unit of every tile; none: each tile's own, which never overflows.
  std::optional<int> exponent;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
};

/// The stack's loss in conversion to half floats.
struct HalfReport {
  double relative_l2 = 0.0;       ///< ||stored - T|| / ||T||, T the light transport matrix
  std::uint64_t underflowed = 0;  ///< nonzero values that became 0
  std::uint64_t bytes = 0;        ///< of stored values; empty tiles take none
};

/// Const calls are thread-safe.
class DenseHalf {
 public:
  /// Reads the whole stack once, tile by tile.
  /// @param name  of the stack, for errors
  /// @throws Error  NaN, infinity or, with a fixed exponent, a value beyond 65504 units (names
  ///                light and pixel); more memory than allowed
  DenseHalf(const StackSource& stack, std::string name, const HalfOptions& options = {});

  /// Memory that a stack takes, at most.
  [[nodiscard]] static std::uint64_t bytes_of(const StackDims& dims);

  [[nodiscard]] StackDims dims() const noexcept { return header_.dims; }
  [[nodiscard]] const HalfReport& report() const noexcept { return report_; }

  /// One picture per environment; lights that are dark in all environments of a batch of 8 and
  /// empty tiles are not read. `bound.coded` is the storage's error, `bound.rounding` that of
  /// sums in float. The bits of a picture do not depend on its neighbours in the batch.
  /// @param reuse  pictures of an earlier call, whose memory is reused
  /// @throws Error  weights with a wrong number of lights or colours
  [[nodiscard]] std::vector<RelitPicture> relight(std::span<const LightWeights> weights,
                                                  KernelCode code = best_kernel_code(),
                                                  std::vector<RelitPicture> reuse = {}) const;

 private:
  struct Part {  ///< one tile and channel
    std::size_t start = 0;
    int exponent = 0;
    bool is_empty = true;
  };

  struct Losses;
  void store_tile(const StackSource& stack, std::size_t i_tile, const HalfOptions& options,
                  Losses& losses);
  void store_channel(std::span<const float> values, const TileRect& rect, int channel,
                     std::size_t i_tile, const HalfOptions& options, Losses& losses);
  [[nodiscard]] TileRect tile_rect(std::size_t i_tile) const;
  [[nodiscard]] Part& part(std::size_t i_tile, int channel);
  [[nodiscard]] const Part& part(std::size_t i_tile, int channel) const;
  [[nodiscard]] std::uint16_t* halfs(const Part& part) const;
  [[nodiscard]] double rounding(const LightQuery& query, int n_segments) const;

  std::string name_;
  BasisHeader header_;  ///< of a direct basis
  BasisTables tables_;  ///< its norms and errors
  HalfReport report_;
  std::size_t stride_ = 0;
  int tiles_x_ = 0;
  std::size_t n_tiles_ = 0;
  std::vector<Part> parts_;  ///< (tiles, channels)
  HugePageBuffer values_;    ///< halfs, (tiles, channels, pixels, stride)
};

}  // namespace haarlight::relight
