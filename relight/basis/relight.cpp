// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/relight.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/light_query.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

class Relighting {
 public:
  Relighting(const BasisFile& basis, std::span<const LightWeights> weights)
      : basis_(basis),
        requested_(basis.header(), basis.tables(), basis.name(), weights),
        queries_(requested_.queries()) {}
  [[nodiscard]] LightQueries& requested() noexcept { return requested_; }
  [[nodiscard]] std::vector<RelitPicture> sum();

 private:
  void sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                std::vector<std::uint64_t>& bytes) const;
  void sum_quantised(int i_tile, const TileRect& rect, int channel,
                     std::vector<std::vector<double>>& sums) const;
  void sum_integers(int i_tile, int channel, std::vector<std::vector<double>>& sums) const;
  void sum_lossless(int i_tile, const TileRect& rect, int channel,
                    std::vector<std::vector<double>>& sums) const;
  [[nodiscard]] bool is_group_needed(int channel, int group) const;

  const BasisFile& basis_;
  LightQueries requested_;
  const std::vector<LightQuery>& queries_;             ///< with the terms kept
  std::vector<std::vector<double>> lossless_weights_;  ///< per query: each light's weight
};

bool Relighting::is_group_needed(int channel, int group) const {
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    const bool is_lossless = basis_.header().coding != BasisCoding::quantised;
    if (basis_.header().coding == BasisCoding::integers && queries_[q].terms > 0) {
      return true;  // no light can be read alone
    }
    const std::vector<double>& values = is_lossless ? lossless_weights_[q] : queries_[q].light;
    for (int index = basis_.group_begin(group); index < basis_.group_end(group); ++index) {
      if (values[count(basis_.order()[count(index)])] != 0.0) {
        return true;
      }
    }
  }
  return false;
}

void Relighting::sum_quantised(int i_tile, const TileRect& rect, int channel,
                               std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (basis_.is_group_empty(i_tile, channel, g) || !is_group_needed(channel, g)) {
      continue;
    }
    const SparseBlock block = basis_.sparse(i_tile, channel, g);
    for (std::size_t q = 0; q < queries_.size(); ++q) {
      if (queries_[q].channel != channel) {
        continue;
      }
      const std::vector<double>& light = queries_[q].light;
      double* sum = sums[q].data();
      // Cells of one coefficient are neighbours: its factor is looked up once.
      for (std::size_t e = 0; e < block.cell.size();) {
        const std::size_t index = block.cell[e] / n_pixels;
        const std::size_t base = index * n_pixels;
        const double factor =
            light[count(basis_.order()[count(basis_.group_begin(g)) + index])];
        if (factor == 0.0) {
          e = static_cast<std::size_t>(
              std::lower_bound(block.cell.begin() + static_cast<std::ptrdiff_t>(e),
                               block.cell.end(), base + n_pixels) -
              block.cell.begin());
          continue;
        }
        for (; e < block.cell.size() && block.cell[e] < base + n_pixels; ++e) {
          sum[block.cell[e] - base] += factor * block.value[e];
        }
      }
    }
  }
  const BasisHeader& header = basis_.header();
  const PixelBlock pixels = basis_.pixels(i_tile, channel);
  std::vector<double> plate(n_pixels);
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    plate_sums(rect, header.plate_degree, pixels.plate, queries_[q].plate, plate);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      sums[q][p] = std::ldexp(header.step, -int{pixels.shift[p]}) * sums[q][p] +
                   plate[p] * pixels.gain[p];
    }
  }
}

void Relighting::sum_lossless(int i_tile, const TileRect& rect, int channel,
                              std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (basis_.is_group_empty(i_tile, channel, g) || !is_group_needed(channel, g)) {
      continue;
    }
    const std::vector<float> rows = basis_.floats(i_tile, channel, g);
    for (std::size_t q = 0; q < queries_.size(); ++q) {
      if (queries_[q].channel != channel) {
        continue;
      }
      for (int k = basis_.group_begin(g); k < basis_.group_end(g); ++k) {
        const double w = lossless_weights_[q][count(k)];
        if (w == 0.0) {
          continue;
        }
        const float* row = rows.data() + count(k - basis_.group_begin(g)) * n_pixels;
        for (std::size_t p = 0; p < n_pixels; ++p) {
          sums[q][p] += w * double{row[p]};
        }
      }
    }
  }
}

/// Integers can only be decoded for all lights at once.
void Relighting::sum_integers(int i_tile, int channel,
                              std::vector<std::vector<double>>& sums) const {
  const bool is_wanted =
      std::any_of(queries_.begin(), queries_.end(),
                  [&](const LightQuery& q) { return q.channel == channel && q.terms > 0; });
  if (!is_wanted) {
    return;
  }
  const std::vector<float> values = basis_.decode_tile(i_tile, channel);
  const std::size_t n_lights = count(basis_.header().dims.n_lights);
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    for (std::size_t p = 0; p < sums[q].size(); ++p) {
      for (std::size_t k = 0; k < n_lights; ++k) {
        sums[q][p] += lossless_weights_[q][k] * double{values[p * n_lights + k]};
      }
    }
  }
}

void Relighting::sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                          std::vector<std::uint64_t>& bytes) const {
  const BasisHeader& header = basis_.header();
  const TileRect rect = basis_.tile_rect(i_tile);
  const std::size_t n_pixels = count(rect.n_pixels());
  std::vector<std::vector<double>> sums(queries_.size(), std::vector<double>(n_pixels));
  for (int c = 0; c < header.dims.channels; ++c) {
    if (header.coding == BasisCoding::integers) {
      sum_integers(i_tile, c, sums);
    } else if (header.coding == BasisCoding::lossless) {
      sum_lossless(i_tile, rect, c, sums);
    } else {
      sum_quantised(i_tile, rect, c, sums);
    }
    for (int g = 0; g < basis_.n_groups(); ++g) {
      if (is_group_needed(c, g)) {
        bytes[count(i_tile)] += basis_.group_bytes(i_tile, c, g);
      }
    }
  }
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    Image<float>& picture = pictures[count(queries_[q].environment)].picture;
    for (int p = 0; p < rect.n_pixels(); ++p) {
      picture(rect.y0 + p / rect.width, rect.x0 + p % rect.width, queries_[q].out_channel) =
          static_cast<float>(sums[q][count(p)]);
    }
  }
}

std::vector<RelitPicture> Relighting::sum() {
  const BasisHeader& header = basis_.header();
  lossless_weights_.clear();
  if (header.coding != BasisCoding::quantised) {
    // sum over kept i of l_i C_i = sum_k (H^-1 l)_k T_k.
    for (const LightQuery& query : queries_) {
      std::vector<double> w = query.given;
      if (query.terms < query.terms_all) {
        w = query.light;
        basis_.basis().inverse(std::span(w));
      }
      lossless_weights_.push_back(std::move(w));
    }
  }
  std::vector<RelitPicture> pictures = requested_.black_pictures();
  std::vector<std::uint64_t> bytes(count(basis_.n_tiles()));
  parallel_for(bytes.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      sum_tile(static_cast<int>(t), pictures, bytes);
    }
  });
  const std::uint64_t bytes_read =
      std::accumulate(bytes.begin(), bytes.end(), std::uint64_t{0});
  for (RelitPicture& picture : pictures) {
    picture.bytes_read = bytes_read;
  }
  requested_.finish(pictures);
  return pictures;
}

}  // namespace

std::vector<RelitPicture> relight(const BasisFile& basis, std::span<const LightWeights> weights,
                                  const RelightOptions& options) {
  Relighting work(basis, weights);
  return relight_as_requested(work.requested(), options, [&work] { return work.sum(); });
}

RelitPicture relight(const BasisFile& basis, const LightWeights& weights,
                     const RelightOptions& options) {
  return std::move(relight(basis, std::span(&weights, 1), options).front());
}

Image<float> relight_stack(const StackSource& stack, const LightWeights& weights) {
  constexpr int kTile = 32;
  const StackDims dims = stack.dims();
  const int colours = static_cast<int>(weights.cols());
  HAARLIGHT_EXPECTS(weights.rows() == dims.n_lights, "one weight per light");
  HAARLIGHT_EXPECTS(colours == 1 || dims.channels == 1 || colours == dims.channels,
                    "one colour, or as many as the stack has channels");
  const int channels = std::max(colours, dims.channels);
  Image<float> picture(dims.height, dims.width, channels);
  const int tiles_x = (dims.width + kTile - 1) / kTile;
  const int tiles_y = (dims.height + kTile - 1) / kTile;
  parallel_for(count(tiles_x) * count(tiles_y), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const int x0 = static_cast<int>(t) % tiles_x * kTile;
      const int y0 = static_cast<int>(t) / tiles_x * kTile;
      const TileRect rect{x0, y0, std::min(kTile, dims.width - x0),
                          std::min(kTile, dims.height - y0)};
      const std::size_t n_pixels = count(rect.n_pixels());
      std::vector<float> values(count(dims.channels) * n_pixels * count(dims.n_lights));
      stack.read_tile(rect, values);
      for (int c = 0; c < channels; ++c) {
        const double* w = weights.data() + (colours == 1 ? 0 : c) * weights.rows();
        const std::size_t from = dims.channels == 1 ? 0 : count(c);
        for (std::size_t p = 0; p < n_pixels; ++p) {
          const float* row = values.data() + (from * n_pixels + p) * count(dims.n_lights);
          double sum = 0.0;
          for (int k = 0; k < dims.n_lights; ++k) {
            sum += w[k] * double{row[k]};
          }
          picture(y0 + static_cast<int>(p) / rect.width, x0 + static_cast<int>(p) % rect.width,
                  c) = static_cast<float>(sum);
        }
      }
    }
  });
  return picture;
}

}  // namespace haarlight::relight
