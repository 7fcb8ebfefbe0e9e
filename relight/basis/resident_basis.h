// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"

/// @file
/// A basis file's blocks unpacked in memory, for a server: relighting sums what it would from the
/// file, in the same order, in double: the same bits, without unpacking. (prepared_basis.h is
/// faster and rounds to float.)

namespace haarlight::relight {

/// Const calls are thread-safe.
class ResidentBasis {
 public:
  /// Borrows the file: its header, tables and basis.
  /// @throws Error  damaged blocks; more than `memory_bytes`
  ResidentBasis(const BasisFile& basis, std::uint64_t memory_bytes);

  /// Memory that a file's blocks take unpacked, about.
  [[nodiscard]] static std::uint64_t bytes_of(const BasisFile& basis);

  [[nodiscard]] const BasisFile& file() const noexcept { return basis_; }
  [[nodiscard]] std::uint64_t bytes() const noexcept { return bytes_; }

  /// The nonzero coefficients of one group of a tile, coefficient by coefficient.
  struct Coefficients {
    std::vector<std::uint32_t> starts;  ///< (coefficients of the group + 1)
    std::vector<std::uint16_t> pixels;
    std::vector<std::int32_t> values;
  };
  [[nodiscard]] const Coefficients& coefficients(int i_tile, int channel, int group) const;
  [[nodiscard]] const PixelBlock& pixels(int i_tile, int channel) const;
  /// (lights, pixels) of a tile of an exact file.
  [[nodiscard]] std::span<const float> lights(int i_tile, int channel) const;

 private:
  void unpack(int i_tile, int channel);
  [[nodiscard]] std::size_t part(int i_tile, int channel) const;

  const BasisFile& basis_;
  std::uint64_t bytes_ = 0;
  std::vector<Coefficients> coefficients_;  ///< (tiles, channels, groups) of a quantised file
  std::vector<PixelBlock> pixels_;          ///< (tiles, channels) of the same
  std::vector<std::vector<float>> lights_;  ///< (tiles, channels) of an exact file
};

/// As relight() from its file, bit for bit; RelitPicture::method is "memory", bytes_read 0.
[[nodiscard]] std::vector<RelitPicture> relight(const ResidentBasis& basis,
                                                std::span<const LightWeights> weights,
                                                const RelightOptions& options = {});

}  // namespace haarlight::relight
