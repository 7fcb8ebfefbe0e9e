// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/relight.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/light_query.h"
#include "relight/basis/plate/tile_plate.h"
#include "relight/basis/resident_basis.h"

namespace haarlight::relight {

namespace {

/// A coefficient, or a light, that a sum needs.
struct Lit {
  std::size_t index = 0;  ///< within its group
  double factor = 0.0;
};

class Relighting {
 public:
  Relighting(const BasisFile& basis, std::span<const LightWeights> weights,
             const ResidentBasis* resident = nullptr)
      : basis_(basis),
        resident_(resident),
        requested_(basis.header(), basis.tables(), basis.name(), weights),
        queries_(requested_.queries()) {}
  [[nodiscard]] LightQueries& requested() noexcept { return requested_; }
  [[nodiscard]] std::vector<RelitPicture> sum();

 private:
  void find_lit();
  void sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                std::vector<std::uint64_t>& bytes) const;
  void sum_quantised(int i_tile, const TileRect& rect, int channel,
                     std::vector<std::vector<double>>& sums) const;
  void sum_group(int i_tile, std::size_t n_pixels, int channel, int group,
                 std::vector<std::vector<double>>& sums) const;
  void sum_integers(int i_tile, int channel, std::vector<std::vector<double>>& sums) const;
  void sum_lossless(int i_tile, const TileRect& rect, int channel,
                    std::vector<std::vector<double>>& sums) const;
  void sum_lights(std::span<const float> rows, std::size_t n_pixels, int channel, int group,
                  std::vector<std::vector<double>>& sums) const;
  [[nodiscard]] bool is_group_needed(int channel, int group) const {
    return needed_[count(channel) * count(basis_.n_groups()) + count(group)] != 0;
  }
  [[nodiscard]] const std::vector<Lit>& lit(std::size_t query, int group) const {
    return lit_[query * count(basis_.n_groups()) + count(group)];
  }

  const BasisFile& basis_;
  const ResidentBasis* resident_;  ///< its blocks unpacked, or null: read from the file
  LightQueries requested_;
  const std::vector<LightQuery>& queries_;             ///< with the terms kept
  std::vector<std::vector<double>> lossless_weights_;  ///< per query: each light's weight
  std::vector<std::vector<Lit>> lit_;                  ///< (queries, groups)
  std::vector<std::uint8_t> needed_;                   ///< (channels, groups)
  std::array<double, kMostShift + 1> steps_{};         ///< of a pixel, by its shift
};

/// What each query needs of each group, and which groups any needs.
void Relighting::find_lit() {
  const std::size_t n_groups = count(basis_.n_groups());
  const BasisCoding coding = basis_.header().coding;
  lit_.assign(queries_.size() * n_groups, {});
  needed_.assign(count(basis_.header().dims.channels) * n_groups, 0);
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    const std::vector<double>& values =
        coding == BasisCoding::quantised ? queries_[q].light : lossless_weights_[q];
    for (int g = 0; g < basis_.n_groups(); ++g) {
      std::vector<Lit>& found = lit_[q * n_groups + count(g)];
      for (int index = basis_.group_begin(g); index < basis_.group_end(g); ++index) {
        const double factor = values[count(basis_.order()[count(index)])];
        if (factor != 0.0) {
          found.push_back({count(index - basis_.group_begin(g)), factor});
        }
      }
      // Of integers no light can be read alone.
      if (!found.empty() || (coding == BasisCoding::integers && queries_[q].terms > 0)) {
        needed_[count(queries_[q].channel) * n_groups + count(g)] = 1;
      }
    }
  }
}

/// Entries of one coefficient are neighbours, in the order of coefficients.
void Relighting::sum_group(int i_tile, std::size_t n_pixels, int channel, int group,
                           std::vector<std::vector<double>>& sums) const {
  const ResidentBasis::Coefficients* held =
      resident_ == nullptr ? nullptr : &resident_->coefficients(i_tile, channel, group);
  const SparseBlock block =
      held == nullptr ? basis_.sparse(i_tile, channel, group) : SparseBlock{};
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    double* sum = sums[q].data();
    if (held != nullptr) {
      for (const Lit& one : lit(q, group)) {
        for (std::size_t e = held->starts[one.index]; e < held->starts[one.index + 1]; ++e) {
          sum[held->pixels[e]] += one.factor * held->values[e];
        }
      }
      continue;
    }
    auto from = block.cell.begin();
    for (const Lit& one : lit(q, group)) {
      const std::size_t base = one.index * n_pixels;
      from = std::lower_bound(from, block.cell.end(), base);
      for (; from != block.cell.end() && *from < base + n_pixels; ++from) {
        sum[*from - base] +=
            one.factor * block.value[count(static_cast<int>(from - block.cell.begin()))];
      }
    }
  }
}

void Relighting::sum_quantised(int i_tile, const TileRect& rect, int channel,
                               std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (!basis_.is_group_empty(i_tile, channel, g) && is_group_needed(channel, g)) {
      sum_group(i_tile, n_pixels, channel, g, sums);
    }
  }
  const PixelBlock read = resident_ == nullptr ? basis_.pixels(i_tile, channel) : PixelBlock{};
  const PixelBlock& pixels = resident_ == nullptr ? read : resident_->pixels(i_tile, channel);
  std::vector<double> plate(n_pixels);
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    plate_sums(rect, basis_.header().plate_degree, pixels.plate, queries_[q].plate, plate);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      sums[q][p] = steps_[pixels.shift[p]] * sums[q][p] + plate[p] * pixels.gain[p];
    }
  }
}

/// @param rows  (lights of the group, pixels)
void Relighting::sum_lights(std::span<const float> rows, std::size_t n_pixels, int channel,
                            int group, std::vector<std::vector<double>>& sums) const {
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    if (queries_[q].channel != channel) {
      continue;
    }
    for (const Lit& one : lit(q, group)) {
      const float* row = rows.data() + one.index * n_pixels;
      for (std::size_t p = 0; p < n_pixels; ++p) {
        sums[q][p] += one.factor * double{row[p]};
      }
    }
  }
}

void Relighting::sum_lossless(int i_tile, const TileRect& rect, int channel,
                              std::vector<std::vector<double>>& sums) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (!is_group_needed(channel, g)) {
      continue;
    }
    if (resident_ != nullptr) {
      sum_lights(resident_->lights(i_tile, channel)
                     .subspan(count(basis_.group_begin(g)) * n_pixels,
                              count(basis_.group_end(g) - basis_.group_begin(g)) * n_pixels),
                 n_pixels, channel, g, sums);
    } else if (!basis_.is_group_empty(i_tile, channel, g)) {
      sum_lights(basis_.floats(i_tile, channel, g), n_pixels, channel, g, sums);
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
    if (header.coding == BasisCoding::quantised) {
      sum_quantised(i_tile, rect, c, sums);
    } else if (header.coding == BasisCoding::integers && resident_ == nullptr) {
      sum_integers(i_tile, c, sums);
    } else {
      sum_lossless(i_tile, rect, c, sums);
    }
    for (int g = 0; g < basis_.n_groups(); ++g) {
      if (resident_ == nullptr && is_group_needed(c, g)) {
        bytes[count(i_tile)] += basis_.group_bytes(i_tile, c, g);
      }
    }
  }
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    Image<float>& picture = pictures[count(queries_[q].environment)].picture;
    const double* sum = sums[q].data();
    for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
      for (int x = rect.x0; x < rect.x0 + rect.width; ++x) {
        picture(y, x, queries_[q].out_channel) = static_cast<float>(*sum++);
      }
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
  find_lit();
  for (std::size_t shift = 0; shift < steps_.size(); ++shift) {
    steps_[shift] = std::ldexp(header.step, -static_cast<int>(shift));
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
    picture.method = resident_ == nullptr ? "file" : "memory";
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

std::vector<RelitPicture> relight(const ResidentBasis& basis,
                                  std::span<const LightWeights> weights,
                                  const RelightOptions& options) {
  Relighting work(basis.file(), weights, &basis);
  return relight_as_requested(work.requested(), options, [&work] { return work.sum(); });
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
