// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/coder/block_codec.h"
#include "tests/relight/basis/made_stack.h"

/// @file
/// A lossless basis file with tiles of any size: haarlight compress writes 32 x 32 only, the
/// format allows others.

namespace haarlight::test {

inline void write_retiled(const MemoryStack& stack, int tile,
                          const std::filesystem::path& file) {
  const auto count = [](int n) { return static_cast<std::size_t>(n); };
  relight::BasisHeader header;
  header.dims = stack.dims();
  header.tile = tile;
  header.basis = relight::BasisKind::direct;
  header.coding = relight::BasisCoding::lossless;
  header.group_ends = relight::default_group_ends(header);
  header.lights = made_lights(header.dims.n_lights);
  header.program = "test";
  const std::size_t n_lights = count(header.dims.n_lights);
  const std::size_t n_pixels = header.dims.n_pixels();
  relight::BasisTables tables;
  tables.coefficient_errors.assign(count(header.dims.channels) * n_lights, 0.0F);
  tables.light_errors = tables.coefficient_errors;
  std::vector<double> energy(tables.light_errors.size());
  for (std::size_t i = 0; i < stack.values().size(); ++i) {
    const double value = stack.values()[i];
    header.peak = std::max(header.peak, std::abs(value));
    energy[i / (n_pixels * n_lights) * n_lights + i % n_lights] += value * value;
  }
  for (const double e : energy) {
    header.stack_norm += e;
    tables.light_norms.push_back(std::nextafter(static_cast<float>(std::sqrt(e)), INFINITY));
  }
  header.stack_norm = std::sqrt(header.stack_norm);
  tables.coefficient_norms = tables.light_norms;
  relight::BasisWriter writer(file);
  for (int y = 0; y < header.dims.height; y += tile) {
    for (int x = 0; x < header.dims.width; x += tile) {
      const TileRect rect{x, y, std::min(tile, header.dims.width - x),
                          std::min(tile, header.dims.height - y)};
      const std::size_t n = count(rect.n_pixels());
      std::vector<float> values(count(header.dims.channels) * n * n_lights);
      stack.read_tile(rect, values);
      for (int c = 0; c < header.dims.channels; ++c) {
        relight::PackedTile packed;
        int begin = 0;
        for (const int end : header.group_ends) {
          std::vector<float> rows;
          for (int k = begin; k < end; ++k) {
            for (std::size_t p = 0; p < n; ++p) {
              rows.push_back(values[(count(c) * n + p) * n_lights + count(k)]);
            }
          }
          packed.groups.push_back({relight::encode_floats(rows, n), 0});
          begin = end;
        }
        writer.append(packed);
      }
    }
  }
  (void)writer.finish(header, tables);
}

}  // namespace haarlight::test
