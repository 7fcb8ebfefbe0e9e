// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/dense_half.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/float_sums.h"
#include "relight/basis/half_float.h"

namespace haarlight::relight {

namespace {

constexpr int kTile = 32;
constexpr std::size_t kBuildBatch = 64;
constexpr std::size_t kPixelsAtOnce = 64;  // their rows stay in the L2 cache for a batch
constexpr int kTopExponent = 15;           // the largest value is stored in [2^14, 2^15]

[[noreturn]] void throw_bad_value(const std::string& what, const std::string& hint,
                                  const std::string& name, const TileRect& rect,
                                  std::size_t i_value, std::size_t n_lights) {
  const std::size_t pixel = i_value / n_lights;
  throw Error(fmt::format("{} under light {} at pixel ({}, {})", what, i_value % n_lights,
                          rect.x0 + static_cast<int>(pixel % count(rect.width)),
                          rect.y0 + static_cast<int>(pixel / count(rect.width))),
              name, hint);
}

/// The exponent that brings `peak` into [2^14, 2^15).
int exponent_of(float peak) { return std::ilogb(peak) + 1 - kTopExponent; }

/// Lights of a pixel's row, with its padding.
std::size_t stride_of(const StackDims& dims) {
  return (count(dims.n_lights) + kDenseLanes - 1) / kDenseLanes * kDenseLanes;
}

/// Infinity or NaN where one of the values is.
float largest_magnitude(std::span<const float> values) {
  std::int32_t largest = 0;  // magnitudes are ordered as their bits are
  for (const float value : values) {
    largest = std::max(largest, std::bit_cast<std::int32_t>(value) & 0x7fffffff);
  }
  return std::bit_cast<float>(largest);
}

/// (n_lights) each: sums of squares.
struct RowLosses {
  std::span<double> energy;  ///< of T
  std::span<double> stored;
  std::span<double> error;
};

/// Rounds one pixel's values to half floats in units of `unit`, a power of two. Loops without
/// branches, for the compiler's vectors.
/// @return  nonzero values that became 0
std::uint64_t store_row(std::span<const float> values, double unit, std::span<std::uint16_t> to,
                        const RowLosses& losses) {
  const double per_unit = 1.0 / unit;  // exact
  for (std::size_t k = 0; k < values.size(); ++k) {
    to[k] = float_to_half(static_cast<float>(values[k] * per_unit));
  }
  std::uint64_t underflowed = 0;
  for (std::size_t k = 0; k < values.size(); ++k) {
    const double t = values[k];
    const double stored = unit * double{half_to_float(to[k])};
    losses.energy[k] += t * t;
    losses.stored[k] += stored * stored;
    losses.error[k] += (stored - t) * (stored - t);
    underflowed += t != 0.0 && stored == 0.0 ? 1 : 0;
  }
  return underflowed;
}

/// Up to kBatch queries of one channel, in the form the kernels need.
struct Chunk {
  std::vector<const LightQuery*> queries;
  std::vector<int> exponents;  ///< each query's weights are in units of 2^exponent
  std::vector<LaneRange> ranges;
  int n_segments = 0;
  std::vector<float> weights;  ///< (stride), or (stride / 8, kBatch, 8)

  /// Sums per pixel.
  [[nodiscard]] std::size_t width() const noexcept { return queries.size() == 1 ? 1 : kBatch; }
};

Chunk make_chunk(std::vector<const LightQuery*> queries, std::size_t stride) {
  Chunk chunk;
  chunk.queries = std::move(queries);
  const bool is_batch = chunk.width() > 1;
  chunk.weights.assign(is_batch ? stride * kBatch : stride, 0.0F);
  std::vector<bool> is_lit(stride / kDenseLanes);
  for (std::size_t q = 0; q < chunk.queries.size(); ++q) {
    const std::vector<double>& w = chunk.queries[q]->given;
    chunk.exponents.push_back(unit_exponent(w));
    for (std::size_t k = 0; k < w.size(); ++k) {
      chunk.weights[is_batch ? (k / 8 * kBatch + q) * 8 + k % 8 : k] =
          in_units(w[k], chunk.exponents.back());
      if (w[k] != 0.0) {
        is_lit[k / kDenseLanes] = true;
      }
    }
  }
  for (std::size_t s = 0; s < is_lit.size(); ++s) {
    if (!is_lit[s]) {
      continue;
    }
    ++chunk.n_segments;
    const int begin = static_cast<int>(s) * kDenseLanes;
    if (!chunk.ranges.empty() && chunk.ranges.back().end == begin) {
      chunk.ranges.back().end += kDenseLanes;
    } else {
      chunk.ranges.push_back({begin, begin + kDenseLanes});
    }
  }
  return chunk;
}

}  // namespace

/// Losses of one tile, later summed in tile order.
struct DenseHalf::Losses {
  std::vector<double> energy;  ///< (channels, n_lights): of the light transport matrix
  std::vector<double> stored;  ///< of what is stored
  std::vector<double> error;
  std::uint64_t underflowed = 0;
  std::uint64_t bytes = 0;

  explicit Losses(std::size_t n) : energy(n), stored(n), error(n) {}
  void add(const Losses& other) {
    const auto sum = [](std::vector<double>& to, const std::vector<double>& from) {
      std::transform(to.begin(), to.end(), from.begin(), to.begin(), std::plus<>());
    };
    sum(energy, other.energy);
    sum(stored, other.stored);
    sum(error, other.error);
    underflowed += other.underflowed;
    bytes += other.bytes;
  }
};

std::uint64_t DenseHalf::bytes_of(const StackDims& dims) {
  return count(dims.channels) * dims.n_pixels() * stride_of(dims) * sizeof(std::uint16_t);
}

DenseHalf::DenseHalf(const StackSource& stack, std::string name, const HalfOptions& options)
    : name_(std::move(name)) {
  header_.dims = stack.dims();
  header_.basis = BasisKind::direct;
  const StackDims& dims = header_.dims;
  stride_ = stride_of(dims);
  tiles_x_ = (dims.width + kTile - 1) / kTile;
  n_tiles_ = count(tiles_x_) * count((dims.height + kTile - 1) / kTile);
  parts_.resize(n_tiles_ * count(dims.channels));
  std::size_t n_values = 0;
  for (std::size_t t = 0; t < n_tiles_; ++t) {
    for (int c = 0; c < dims.channels; ++c) {
      part(t, c).start = n_values;
      n_values += count(tile_rect(t).n_pixels()) * stride_;
    }
  }
  const std::uint64_t bytes = bytes_of(dims);
  if (bytes > options.memory_bytes) {
    throw Error(fmt::format("the stack as half floats takes {} bytes of memory, the budget is "
                            "{}",
                            bytes, options.memory_bytes),
                name_, "give more memory, or relight from a compressed basis file");
  }
  values_ = HugePageBuffer(bytes);  // empty tiles are never written: they cost nothing

  const std::size_t n_norms = count(dims.channels) * count(dims.n_lights);
  Losses sum(n_norms);
  for (std::size_t begin = 0; begin < n_tiles_; begin += kBuildBatch) {
    std::vector<Losses> losses(std::min(kBuildBatch, n_tiles_ - begin), Losses(n_norms));
    parallel_for(losses.size(), 1, [&](std::size_t from, std::size_t to) {
      for (std::size_t i = from; i < to; ++i) {
        store_tile(stack, begin + i, options, losses[i]);
      }
    });
    for (const Losses& tile : losses) {
      sum.add(tile);
    }
  }
  report_.underflowed = sum.underflowed;
  report_.bytes = sum.bytes;
  const double energy = std::accumulate(sum.energy.begin(), sum.energy.end(), 0.0);
  const double error = std::accumulate(sum.error.begin(), sum.error.end(), 0.0);
  report_.relative_l2 = energy > 0.0 ? std::sqrt(error / energy) : 0.0;
  tables_.light_norms = root_round_up(sum.energy);
  tables_.light_errors = root_round_up(sum.error);
  tables_.coefficient_norms = root_round_up(sum.stored);
  tables_.coefficient_errors = tables_.light_errors;
}

TileRect DenseHalf::tile_rect(std::size_t i_tile) const {
  const int x0 = static_cast<int>(i_tile) % tiles_x_ * kTile;
  const int y0 = static_cast<int>(i_tile) / tiles_x_ * kTile;
  return {x0, y0, std::min(kTile, header_.dims.width - x0),
          std::min(kTile, header_.dims.height - y0)};
}

DenseHalf::Part& DenseHalf::part(std::size_t i_tile, int channel) {
  return parts_[i_tile * count(header_.dims.channels) + count(channel)];
}

const DenseHalf::Part& DenseHalf::part(std::size_t i_tile, int channel) const {
  return parts_[i_tile * count(header_.dims.channels) + count(channel)];
}

std::uint16_t* DenseHalf::halfs(const Part& part) const {
  return reinterpret_cast<std::uint16_t*>(values_.bytes().data()) + part.start;
}

void DenseHalf::store_tile(const StackSource& stack, std::size_t i_tile,
                           const HalfOptions& options, Losses& losses) {
  const TileRect rect = tile_rect(i_tile);
  const std::size_t per_channel = count(rect.n_pixels()) * count(header_.dims.n_lights);
  std::vector<float> values(count(header_.dims.channels) * per_channel);
  stack.read_tile(rect, values);
  for (int c = 0; c < header_.dims.channels; ++c) {
    store_channel(std::span(values).subspan(count(c) * per_channel, per_channel), rect, c,
                  i_tile, options, losses);
  }
}

void DenseHalf::store_channel(std::span<const float> values, const TileRect& rect, int channel,
                              std::size_t i_tile, const HalfOptions& options, Losses& losses) {
  const std::size_t n_lights = count(header_.dims.n_lights);
  const float peak = largest_magnitude(values);
  if (!std::isfinite(peak)) {
    const auto bad =
        std::find_if(values.begin(), values.end(), [](float t) { return !std::isfinite(t); });
    throw_bad_value("the stack is not finite",
                    "shoot that light again; one such value would spread", name_, rect,
                    static_cast<std::size_t>(bad - values.begin()), n_lights);
  }
  if (peak == 0.0F) {
    return;
  }
  Part& to = part(i_tile, channel);
  to.is_empty = false;
  to.exponent = options.exponent.value_or(exponent_of(peak));
  const double unit = std::ldexp(1.0, to.exponent);
  if (peak / unit > double{kLargestHalf}) {
    const auto beyond = std::find_if(values.begin(), values.end(), [&](float t) {
      return std::abs(t / unit) > double{kLargestHalf};
    });
    throw_bad_value(
        fmt::format("{:g} units of 2^{} leave the range of half floats, which end at 65504,",
                    *beyond / unit, to.exponent),
        "let each tile choose its own unit", name_, rect,
        static_cast<std::size_t>(beyond - values.begin()), n_lights);
  }
  const std::size_t first = count(channel) * n_lights;
  const RowLosses row_losses{std::span(losses.energy).subspan(first, n_lights),
                             std::span(losses.stored).subspan(first, n_lights),
                             std::span(losses.error).subspan(first, n_lights)};
  for (std::size_t p = 0; p < values.size() / n_lights; ++p) {
    const std::span<std::uint16_t> row(halfs(to) + p * stride_, n_lights);
    losses.underflowed +=
        store_row(values.subspan(p * n_lights, n_lights), unit, row, row_losses);
  }
  losses.bytes += count(rect.n_pixels()) * stride_ * sizeof(std::uint16_t);
}

/// A light's value passes the rounding of its weight and product, one addition per segment,
/// five of the fold, and the picture's own.
double DenseHalf::rounding(const LightQuery& query, int n_segments) const {
  constexpr int kOthers = 8;
  const std::size_t first = count(query.channel) * query.given.size();
  const int exponent = unit_exponent(query.given);
  double error = 0.0;
  for (std::size_t k = 0; k < query.given.size(); ++k) {
    error += float_sum_error(query.given[k], exponent, n_segments + kOthers) *
             double{tables_.coefficient_norms[first + k]};
  }
  return error;
}

std::vector<RelitPicture> DenseHalf::relight(std::span<const LightWeights> weights,
                                             KernelCode code,
                                             std::vector<RelitPicture> reuse) const {
  const LightQueries requested(header_, tables_, name_, weights);
  std::vector<RelitPicture> pictures = requested.black_pictures(std::move(reuse));
  std::vector<double> rounding_squares(pictures.size());
  std::vector<std::vector<Chunk>> chunks(count(header_.dims.channels));
  for (int c = 0; c < header_.dims.channels; ++c) {
    for (std::vector<const LightQuery*>& queries : batches_of_channel(requested, c)) {
      Chunk chunk = make_chunk(std::move(queries), stride_);
      for (const LightQuery* query : chunk.queries) {
        const double error = rounding(*query, chunk.n_segments);
        rounding_squares[count(query->environment)] += error * error;
      }
      if (chunk.n_segments > 0) {
        chunks[count(c)].push_back(std::move(chunk));
      }
    }
  }
  std::vector<std::uint64_t> bytes(n_tiles_);
  const auto sum_tile = [&](std::size_t t) {
    const TileRect rect = tile_rect(t);
    const std::size_t n_pixels = count(rect.n_pixels());
    std::vector<float> sums;  // (chunks, pixels, width)
    for (int c = 0; c < header_.dims.channels; ++c) {
      const Part& from = part(t, c);
      if (from.is_empty) {
        continue;
      }
      int n_segments = 0;
      std::size_t n_sums = 0;
      for (const Chunk& chunk : chunks[count(c)]) {
        n_segments = std::max(n_segments, chunk.n_segments);
        n_sums += n_pixels * chunk.width();
      }
      sums.resize(n_sums);
      for (std::size_t begin = 0; begin < n_pixels; begin += kPixelsAtOnce) {
        const DenseRows rows{halfs(from) + begin * stride_,
                             std::min(kPixelsAtOnce, n_pixels - begin), stride_};
        std::span<float> rest = sums;
        for (const Chunk& chunk : chunks[count(c)]) {
          const std::size_t width = chunk.width();
          const std::span<float> out = rest.subspan(begin * width, rows.n_pixels * width);
          if (width == 1) {
            sum_dense(code, rows, chunk.ranges, chunk.weights, out);
          } else {
            sum_dense_batch(code, rows, chunk.ranges, chunk.weights, out);
          }
          rest = rest.subspan(n_pixels * width);
        }
      }
      // Only now: interleaving stores to a picture's distant rows would slow the reads by a
      // fifth.
      std::span<const float> rest = sums;
      for (const Chunk& chunk : chunks[count(c)]) {
        for (std::size_t q = 0; q < chunk.queries.size(); ++q) {
          put_sums(rest.subspan(q), chunk.width(), chunk.exponents[q] + from.exponent, rect,
                   *chunk.queries[q], pictures);
        }
        rest = rest.subspan(n_pixels * chunk.width());
      }
      bytes[t] += n_pixels * count(n_segments) * kDenseLanes * sizeof(std::uint16_t);
    }
  };
  parallel_for(n_tiles_, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      sum_tile(t);
    }
  });
  const std::uint64_t bytes_read =
      std::accumulate(bytes.begin(), bytes.end(), std::uint64_t{0});
  for (std::size_t e = 0; e < pictures.size(); ++e) {
    pictures[e].bound.rounding = std::sqrt(rounding_squares[e]);
    pictures[e].bytes_read = bytes_read;
    pictures[e].method = "dense half";
  }
  requested.finish(pictures);
  return pictures;
}

}  // namespace haarlight::relight
