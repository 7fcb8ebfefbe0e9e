// SPDX-License-Identifier: Apache-2.0
#include "relight/study/study_tiles.h"

#include <algorithm>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/plate/plate.h"
#include "relight/basis/plate/plate_gain.h"
#include "relight/study/coefficient_coder.h"

namespace haarlight::relight {

namespace {

constexpr int kLargestTile = 128;
constexpr int kSmallestTile = 8;
constexpr std::size_t kPiece = 64;  // pixels

}  // namespace

StudyTiles::StudyTiles(const StudyCapture& capture, const BasisStudyOptions& options)
    : capture_(capture) {
  const StackDims dims = capture.stack->dims();
  if (capture.plate != nullptr) {
    const StackDims plate = capture.plate->dims();
    if (plate.width != dims.width || plate.height != dims.height ||
        plate.n_lights != dims.n_lights ||
        (plate.channels != 1 && plate.channels != dims.channels)) {
      throw Error(
          fmt::format("a clean plate of {} x {} x {} under {} lights for a capture of {} x "
                      "{} x {} under {}",
                      plate.width, plate.height, plate.channels, plate.n_lights, dims.width,
                      dims.height, dims.channels, dims.n_lights),
          "clean plate", "make the clean plate from this capture's rig, or use --plate none");
    }
    const std::uint64_t bytes = std::uint64_t{plate.n_pixels()} * count(plate.channels) *
                                count(plate.n_lights) * sizeof(float);
    if (bytes <= options.memory_bytes / 4) {
      plate_ = read_all(*capture.plate, bytes);
    }
  }
  // Values as read, lights and residual of all channels, the plate; coefficients, their copy,
  // errors.
  const std::size_t n_plate =
      capture.plate != nullptr ? count(capture.plate->dims().channels) : 0;
  const std::uint64_t pixel_bytes =
      count(dims.n_lights) * sizeof(float) * (3 * count(dims.channels) + n_plate + 3);
  tile_ = kLargestTile;
  while (tile_ >= kSmallestTile &&
         pixel_bytes * count(tile_) * count(tile_) > options.memory_bytes / 2) {
    tile_ /= 2;
  }
  if (tile_ < kSmallestTile) {
    throw Error(fmt::format("{} bytes of memory hold no tile of {} lights",
                            options.memory_bytes, dims.n_lights),
                "--memory", fmt::format("allow {} bytes", 2 * pixel_bytes * 64));
  }
  std::vector<TileRect> all;
  for (int y = 0; y < dims.height; y += tile_) {
    for (int x = 0; x < dims.width; x += tile_) {
      all.push_back({x, y, std::min(tile_, dims.width - x), std::min(tile_, dims.height - y)});
    }
  }
  n_tiles_ = static_cast<int>(all.size());
  const int n = options.n_tiles > 0 ? std::min(options.n_tiles, n_tiles_) : n_tiles_;
  for (int i = 0; i < n; ++i) {
    // The middles of n equal parts of the list.
    rects_.push_back(all[count(static_cast<int>((2LL * i + 1) * n_tiles_ / (2LL * n)))]);
    n_pixels_ += count(rects_.back().n_pixels());
  }
}

std::vector<StudyTile> StudyTiles::read(const TileRect& rect, bool needs_plate) const {
  const StackDims dims = capture_.stack->dims();
  const std::size_t n_lights = count(dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  std::vector<float> values(count(dims.channels) * n_pixels * n_lights);
  capture_.stack->read_tile(rect, values);
  const StackSource* plate_source =
      plate_ ? static_cast<const StackSource*>(&*plate_) : capture_.plate;
  const bool has_plate = needs_plate && plate_source != nullptr;
  std::vector<float> plate;
  if (has_plate) {
    plate.resize(count(plate_source->dims().channels) * n_pixels * n_lights);
    if (plate_source->dims().channels == 1) {
      parallel_for(count(rect.height), 4, [&](std::size_t begin, std::size_t end) {
        const std::size_t row = count(rect.width) * n_lights;
        plate_source->read_tile({rect.x0, rect.y0 + static_cast<int>(begin), rect.width,
                                 static_cast<int>(end - begin)},
                                std::span(plate).subspan(begin * row, (end - begin) * row));
      });
    } else {
      plate_source->read_tile(rect, plate);
    }
  }
  std::vector<StudyTile> tiles;
  for (int c = 0; c < dims.channels; ++c) {
    StudyTile tile;
    tile.rect = rect;
    tile.channel = c;
    const float* from = values.data() + count(c) * n_pixels * n_lights;
    tile.lights.assign(from, from + n_pixels * n_lights);
    if (has_plate) {
      const std::size_t plate_channel = plate_source->dims().channels == 1 ? 0 : count(c);
      const float* b = plate.data() + plate_channel * n_pixels * n_lights;
      tile.gains.resize(n_pixels);
      tile.residual.resize(tile.lights.size());
      parallel_for(n_pixels, kPiece, [&](std::size_t begin, std::size_t end) {
        PlateGain gain;
        for (std::size_t p = begin; p < end; ++p) {
          const std::span<const float> t(tile.lights.data() + p * n_lights, n_lights);
          tile.gains[p] = gain(t, {b + p * n_lights, n_lights});
        }
      });
      round_to_halves(tile.gains);  // what is stored: the residual is relative to it
      parallel_for(n_pixels, kPiece, [&](std::size_t begin, std::size_t end) {
        for (std::size_t p = begin; p < end; ++p) {
          for (std::size_t k = p * n_lights; k < (p + 1) * n_lights; ++k) {
            tile.residual[k] = tile.lights[k] - tile.gains[p] * b[k];
          }
        }
      });
    }
    tiles.push_back(std::move(tile));
  }
  return tiles;
}

}  // namespace haarlight::relight
