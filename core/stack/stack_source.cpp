// SPDX-License-Identifier: Apache-2.0
#include "haarlight/core/stack/stack_source.h"

#include <algorithm>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "core/pick_columns.h"
#include "haarlight/core/error.h"

namespace haarlight {

void require_tile(const StackDims& dims, const TileRect& rect, std::size_t n_values) {
  HAARLIGHT_EXPECTS(rect.x0 >= 0 && rect.y0 >= 0 && rect.width > 0 && rect.height > 0 &&
                        rect.x0 + rect.width <= dims.width &&
                        rect.y0 + rect.height <= dims.height,
                    "a tile inside the picture");
  HAARLIGHT_EXPECTS(
      n_values == count(dims.channels) * count(rect.n_pixels()) * count(dims.n_lights),
      "room for the tile's values");
}

void StackSource::read_lights(const TileRect& rect, std::span<const int> lights,
                              std::span<float> out) const {
  const StackDims all = dims();
  const std::size_t n_lights = count(all.n_lights);
  const std::size_t n_rows = count(all.channels) * count(rect.n_pixels());
  HAARLIGHT_EXPECTS(out.size() == n_rows * lights.size(), "room for the lights' values");
  std::vector<float> values(n_rows * n_lights);
  read_tile(rect, values);
  pick_columns(values, n_lights, lights, out);
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
  require_tile(dims_, rect, out.size());
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
