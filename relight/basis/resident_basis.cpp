// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/resident_basis.h"

#include <numeric>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

/// Of one file's values: every coefficient's number and pixel, or every light's float.
std::uint64_t coefficients_bytes(const BasisHeader& header) {
  const double values =
      header.mean_coefficients * double(header.dims.channels) * double(header.dims.n_pixels());
  return static_cast<std::uint64_t>(values) * (sizeof(std::uint16_t) + sizeof(std::int32_t)) +
         header.dims.n_pixels() * count(header.dims.channels) *
             (sizeof(std::int32_t) + sizeof(std::uint8_t));
}

}  // namespace

std::uint64_t ResidentBasis::bytes_of(const BasisFile& basis) {
  const BasisHeader& header = basis.header();
  return header.coding == BasisCoding::quantised
             ? coefficients_bytes(header)
             : header.dims.n_pixels() * count(header.dims.channels) *
                   count(header.dims.n_lights) * sizeof(float);
}

ResidentBasis::ResidentBasis(const BasisFile& basis, std::uint64_t memory_bytes)
    : basis_(basis), bytes_(bytes_of(basis)) {
  if (bytes_ > memory_bytes) {
    throw Error(fmt::format("the basis takes {} MB of memory unpacked, {} MB are allowed",
                            bytes_ >> 20U, memory_bytes >> 20U),
                basis.name(), "give more by --memory");
  }
  const std::size_t n_parts = count(basis.n_tiles()) * count(basis.header().dims.channels);
  if (basis.header().coding == BasisCoding::quantised) {
    coefficients_.resize(n_parts * count(basis.n_groups()));
    pixels_.resize(n_parts);
  } else {
    lights_.resize(n_parts);
  }
  const int channels = basis.header().dims.channels;
  parallel_for(n_parts, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      unpack(static_cast<int>(i) / channels, static_cast<int>(i) % channels);
    }
  });
}

void ResidentBasis::unpack(int i_tile, int channel) {
  const std::size_t n_pixels = count(basis_.tile_rect(i_tile).n_pixels());
  const std::size_t at = part(i_tile, channel);
  if (basis_.header().coding != BasisCoding::quantised) {
    const std::vector<float> rows = basis_.decode_tile(i_tile, channel);
    const std::size_t n_lights = count(basis_.header().dims.n_lights);
    std::vector<float>& to = lights_[at];
    to.resize(rows.size());
    for (std::size_t p = 0; p < n_pixels; ++p) {
      for (std::size_t k = 0; k < n_lights; ++k) {
        to[k * n_pixels + p] = rows[p * n_lights + k];
      }
    }
    return;
  }
  pixels_[at] = basis_.pixels(i_tile, channel);
  for (int g = 0; g < basis_.n_groups(); ++g) {
    Coefficients& to = coefficients_[at * count(basis_.n_groups()) + count(g)];
    to.starts.assign(count(basis_.group_end(g) - basis_.group_begin(g)) + 1, 0);
    if (basis_.is_group_empty(i_tile, channel, g)) {
      continue;
    }
    SparseBlock block = basis_.sparse(i_tile, channel, g);
    to.pixels.reserve(block.cell.size());
    for (const std::uint32_t cell : block.cell) {
      ++to.starts[cell / n_pixels + 1];
      to.pixels.push_back(static_cast<std::uint16_t>(cell % n_pixels));
    }
    std::partial_sum(to.starts.begin(), to.starts.end(), to.starts.begin());
    to.values = std::move(block.value);
    to.values.shrink_to_fit();
  }
}

std::size_t ResidentBasis::part(int i_tile, int channel) const {
  return count(i_tile) * count(basis_.header().dims.channels) + count(channel);
}

const ResidentBasis::Coefficients& ResidentBasis::coefficients(int i_tile, int channel,
                                                               int group) const {
  return coefficients_[part(i_tile, channel) * count(basis_.n_groups()) + count(group)];
}

const PixelBlock& ResidentBasis::pixels(int i_tile, int channel) const {
  return pixels_[part(i_tile, channel)];
}

std::span<const float> ResidentBasis::lights(int i_tile, int channel) const {
  return lights_[part(i_tile, channel)];
}

}  // namespace haarlight::relight
