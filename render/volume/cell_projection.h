// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "render/loop/tile_renderer.h"
#include "render/volume/cell_splat.h"
#include "render/volume/visibility_order.h"
#include "render/volume/volume_scene.h"

/// @file
/// The exact picture of a mesh by its cells, one after the other, the nearest first: each is projected
/// onto the pixels, and each pixel's ray gathers what it passes of the cell [Williams98]. A second way
/// to the picture of VolumeRayCaster, with which it shares the sides of edges and the sums of stretches,
/// but neither the walk from cell to cell nor its order.
///
/// A depth for each pixel is the witness: a stretch before what the pixel has behind it already is a
/// violation of the order, and counted.

namespace haarlight::render {

/// What is drawn of cells that cover fewer than two pixels' centres.
enum class SmallCells : std::uint8_t {
  sampled,   ///< what rays through pixels' centres pass: exact there, and nothing between them
  splatted,  ///< their volume, spread over 3 x 3 pixels: cell_splat.h; approximate
};
inline constexpr auto kSmallCellsWords =
    std::to_array<std::string_view>({"sampled", "splatted"});
constexpr std::span<const std::string_view> words_of(SmallCells) { return kSmallCellsWords; }

/// What a picture took.
struct ProjectionCounts {
  std::uint64_t stretches = 0;  ///< of rays within cells
  std::uint64_t segments = 0;   ///< as VolumeCounts, these and below
  std::uint64_t exact_sides = 0;
  std::uint64_t lost_points = 0;
  std::uint64_t unresolved = 0;
  std::uint64_t violations = 0;  ///< stretches before others that were gathered before them
};

class CellProjection final : public TileRenderer {
 public:
  /// @param scene  outlives it
  /// @throws Error  as connect_cells() and visibility_order(); optical depths beyond kLargestDepth
  explicit CellProjection(const VolumeScene& scene,
                          SmallCells small_cells = SmallCells::sampled);
  /// The same in another order, which may be wrong: to see what the witness says.
  CellProjection(const VolumeScene& scene, VisibilityOrder order);
  ~CellProjection() override;
  CellProjection(const CellProjection&) = delete;
  CellProjection& operator=(const CellProjection&) = delete;

  /// What it and its scene take, for a check before it is made.
  [[nodiscard]] static std::uint64_t bytes_needed(const VolumeScene& scene,
                                                  SmallCells small_cells);
  /// How long the constructor took.
  [[nodiscard]] double prepare_seconds() const { return prepare_seconds_; }
  [[nodiscard]] const VisibilityOrder& order() const { return order_; }
  [[nodiscard]] const VolumeView& view() const { return *view_; }
  /// Cells that are empty whatever their fields, and were left out.
  [[nodiscard]] std::size_t n_transparent() const { return n_transparent_; }
  /// Pieces that are splats: neither stretches nor the witness know them.
  [[nodiscard]] std::size_t n_splats() const { return splats_.size(); }
  /// Of the film, that show cells.
  [[nodiscard]] std::size_t n_tiles() const;

  /// A film with the layers of VolumeRayCaster, of the camera's size, one sample of each pixel.
  /// @return  stretches
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

  [[nodiscard]] ProjectionCounts counts() const;
  /// Once the picture is rendered: the first violation, by the cells' numbers in the file; empty: none.
  [[nodiscard]] std::string violation() const;

 private:
  class TilePicture;

  void leave_out_transparent();
  void find_splats();
  [[nodiscard]] std::array<PixelRange, 2> pixels_of(std::uint32_t number) const;
  void sort_into_tiles();
  /// Of the one that is x from the left and y from above.
  [[nodiscard]] std::size_t number_of_tile(int x, int y) const;

  std::unique_ptr<const VolumeView> view_;
  VisibilityOrder order_;
  std::size_t n_transparent_ = 0;
  std::vector<CellSplat> splats_;
  std::vector<std::uint32_t> splat_of_piece_;  ///< kNoSplat: none; empty: of all
  /// Of each tile of the film the pieces that may be seen in it, numbers in order_, the nearest first.
  std::vector<std::vector<std::uint32_t>> pieces_of_tiles_;
  double prepare_seconds_ = 0.0;
  mutable std::mutex mutex_;
  mutable ProjectionCounts counts_;
  mutable std::string violation_;
};

}  // namespace haarlight::render
