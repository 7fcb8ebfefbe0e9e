// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "relight/study/basis_study.h"

/// @file
/// A capture tile by tile, with and without its clean plate, as input to the comparison of
/// bases.

namespace haarlight::relight {

/// One channel of a tile.
struct StudyTile {
  TileRect rect;
  int channel = 0;
  std::size_t first = 0;        ///< number of values (pixels of all channels) studied before it
  std::vector<float> lights;    ///< T, the light transport matrix: (pixels, n_lights)
  std::vector<float> residual;  ///< T - g B with g as stored; empty without a plate
  std::vector<float> gains;     ///< (pixels)
  [[nodiscard]] std::span<const float> values(bool has_plate) const {
    return has_plate ? residual : lights;
  }
};

class StudyTiles {
 public:
  /// Chooses the tile size by the available memory, at most 128 pixels per side, and the tiles.
  /// @throws Error  memory for less than 8 pixels per side; a clean plate of another shape
  StudyTiles(const StudyCapture& capture, const BasisStudyOptions& options);

  [[nodiscard]] int tile() const noexcept { return tile_; }
  [[nodiscard]] int n_tiles() const noexcept { return n_tiles_; }
  [[nodiscard]] const std::vector<TileRect>& rects() const noexcept { return rects_; }
  /// Pixels of the tiles that are studied.
  [[nodiscard]] std::uint64_t n_pixels() const noexcept { return n_pixels_; }

  /// All tiles and channels, one after the other. @throws Error  what the sources throw
  template <class Work>
  void for_each(bool needs_plate, Work work) const {
    std::size_t first = 0;
    for (const TileRect& rect : rects_) {
      for (StudyTile& tile : read(rect, needs_plate)) {
        tile.first = first;
        first += static_cast<std::size_t>(rect.n_pixels());
        work(static_cast<const StudyTile&>(tile));
      }
    }
  }

 private:
  [[nodiscard]] std::vector<StudyTile> read(const TileRect& rect, bool needs_plate) const;

  const StudyCapture& capture_;
  std::optional<MemoryStack> plate_;  ///< where it fits: it is read in every pass
  int tile_ = 0;
  int n_tiles_ = 0;
  std::vector<TileRect> rects_;
  std::uint64_t n_pixels_ = 0;
};

}  // namespace haarlight::relight
