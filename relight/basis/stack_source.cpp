// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/stack_source.h"

#include <algorithm>

#include <fmt/format.h>

#include "core/error.h"
#include "core/files.h"
#include "core/parallel.h"

namespace haarlight {

namespace {

std::size_t count(int n) { return static_cast<std::size_t>(n); }

void require_rect(const StackDims& dims, const TileRect& rect, std::size_t size) {
  HAARLIGHT_EXPECTS(rect.x0 >= 0 && rect.y0 >= 0 && rect.width > 0 && rect.height > 0 &&
                        rect.x0 + rect.width <= dims.width &&
                        rect.y0 + rect.height <= dims.height,
                    "a tile inside the picture");
  HAARLIGHT_EXPECTS(
      size == count(dims.channels) * count(rect.n_pixels()) * count(dims.n_lights),
      "room for the tile's values");
}

}  // namespace

StackDims LightStackSource::dims() const {
  const StackShape& shape = stack_.shape();
  return {shape.width, shape.height, shape.channels, shape.n_lights};
}

void LightStackSource::read_tile(const TileRect& rect, std::span<float> out) const {
  const StackShape& shape = stack_.shape();
  require_rect(dims(), rect, out.size());
  const std::size_t row_values = count(rect.width) * count(shape.n_lights);
  for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
    const int i_band = y / shape.band_rows;
    const int band_y0 = i_band * shape.band_rows;
    const int band_rows = std::min(shape.band_rows, shape.height - band_y0);
    const std::span<const float> band = stack_.band(i_band);
    for (int c = 0; c < shape.channels; ++c) {
      const std::size_t row = count(c) * count(band_rows) + count(y - band_y0);
      const std::size_t from =
          (row * count(shape.width) + count(rect.x0)) * count(shape.n_lights);
      const std::size_t to = (count(c) * count(rect.height) + count(y - rect.y0)) * row_values;
      const std::span<const float> row_of_tile(band.data() + from, row_values);
      std::copy(row_of_tile.begin(), row_of_tile.end(),
                out.begin() + static_cast<std::ptrdiff_t>(to));
      // A stack may be larger than memory: what was copied need not stay resident.
      drop_pages(std::as_bytes(row_of_tile));
    }
  }
}

MemoryStack::MemoryStack(const StackDims& dims)
    : MemoryStack(dims, std::vector<float>(dims.n_pixels() * count(dims.channels) *
                                           count(dims.n_lights))) {}

MemoryStack::MemoryStack(const StackDims& dims, std::vector<float> values)
    : dims_(dims), values_(std::move(values)) {
  HAARLIGHT_EXPECTS(
      values_.size() == dims.n_pixels() * count(dims.channels) * count(dims.n_lights),
      "values of the stack's shape");
}

float& MemoryStack::at(int channel, int y, int x, int light) {
  return values_[((count(channel) * count(dims_.height) + count(y)) * count(dims_.width) +
                  count(x)) *
                     count(dims_.n_lights) +
                 count(light)];
}

void MemoryStack::read_tile(const TileRect& rect, std::span<float> out) const {
  require_rect(dims_, rect, out.size());
  const std::size_t row_values = count(rect.width) * count(dims_.n_lights);
  auto to = out.begin();
  for (int c = 0; c < dims_.channels; ++c) {
    for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
      const std::size_t pixel =
          (count(c) * count(dims_.height) + count(y)) * count(dims_.width) + count(rect.x0);
      const auto from =
          values_.begin() + static_cast<std::ptrdiff_t>(pixel * count(dims_.n_lights));
      to = std::copy_n(from, row_values, to);
    }
  }
}

MemoryStack read_all(const StackSource& source, std::size_t max_bytes) {
  const StackDims dims = source.dims();
  const std::size_t n_values = dims.n_pixels() * count(dims.channels) * count(dims.n_lights);
  if (n_values > max_bytes / sizeof(float)) {
    throw Error(
        fmt::format("the light stack needs {} bytes in memory", n_values * sizeof(float)),
        "light stack", "work tile by tile, or allow more memory");
  }
  std::vector<float> values(n_values);
  if (dims.channels == 1) {
    // Bands of rows are stored one after the other: read them in parallel.
    constexpr std::size_t kRows = 8;
    parallel_for(count(dims.height), kRows, [&](std::size_t begin, std::size_t end) {
      const std::size_t row_values = count(dims.width) * count(dims.n_lights);
      source.read_tile(
          {0, static_cast<int>(begin), dims.width, static_cast<int>(end - begin)},
          std::span(values).subspan(begin * row_values, (end - begin) * row_values));
    });
  } else {
    source.read_tile({0, 0, dims.width, dims.height}, values);
  }
  return {dims, std::move(values)};
}

}  // namespace haarlight
