// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/prepared_basis.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/float_sums.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

constexpr int kMostLights = 1 << 15;  // an index and its high part share 16 bits
// Nanoseconds per entry on one core, single and for a batch (bench/relight/kernels.cpp); only
// their ratios matter.
constexpr double kRowCost = 0.45;
constexpr double kListCost = 1.0;
constexpr double kBatchRowCost = 2.0;
constexpr double kBatchListCost = 4.0;
// Above this fraction of the lights, a pixel's coefficients cost more than its half floats.
constexpr double kDenseFraction = 0.25;
// From one lit list in 16 on, scanning all is faster than searching for each.
constexpr std::size_t kSearchCost = 16;
constexpr std::size_t kTilesAtOnce = 64;
constexpr std::size_t kTileParts = 8;  // partial sums of the pictures' products

/// A coefficient in whole steps.
struct Entry {
  std::uint32_t index = 0;
  double value = 0.0;
};

/// One grid's entries of every pixel that has some, by index within the grid, times the pixel's
/// scale; high and low parts joined.
std::vector<std::vector<Entry>> read_rows(const SparseTile& tile, int n_lights,
                                          std::size_t grid, std::size_t per_grid) {
  std::vector<std::vector<Entry>> rows(tile.n_pixels);
  const std::size_t begin = grid * per_grid;
  for (std::size_t l = 0; l < tile.list_index.size(); ++l) {
    const std::size_t index = tile.list_index[l];
    const bool is_high = index >= count(n_lights);
    const std::size_t offset = (is_high ? index - count(n_lights) : index) - begin;
    if (offset >= per_grid) {
      continue;
    }
    for (const ListEntry& entry : tile.list(l)) {
      const double scale = tile.scales.empty() ? 1.0 : double{tile.scales[entry.pixel]};
      const double value = (is_high ? 65536.0 : 1.0) * scale * entry.value;
      std::vector<Entry>& row = rows[entry.pixel];
      // Lists ascend; those of high parts come after all others.
      const auto at = !is_high ? row.end()
                               : std::lower_bound(row.begin(), row.end(), offset,
                                                  [](const Entry& e, std::size_t wanted) {
                                                    return e.index < wanted;
                                                  });
      if (at != row.end() && at->index == offset) {
        at->value += value;
      } else {
        row.insert(at, {static_cast<std::uint32_t>(offset), value});
      }
    }
  }
  return rows;
}

/// What a file takes as rows and lists, about.
double sparse_bytes(const BasisHeader& header) {
  const double rows = double(header.dims.channels) * double(header.dims.n_pixels());
  const double of_entry = sizeof(RowBlock) / 8.0 + sizeof(ListEntry);
  return rows *
         (header.mean_coefficients * of_entry + 2 * sizeof(std::int32_t) + sizeof(float));
}

}  // namespace

bool PreparedBasis::can_hold(const BasisFile& basis, std::uint64_t memory_bytes) {
  return basis.header().coding == BasisCoding::quantised &&
         basis.header().dims.n_lights <= kMostLights &&
         sparse_bytes(basis.header()) <= static_cast<double>(memory_bytes);
}

/// Up to kBatch queries of one channel, in the form the kernels need.
struct PreparedBasis::Chunk {
  std::vector<const LightQuery*> queries;
  std::vector<int> exponents;  ///< each query's factors are in units of 2^exponent
  RelightMethod method = RelightMethod::sparse_rows;
  std::size_t width = 1;             ///< 1 or kBatch
  std::vector<float> light;          ///< (2 n_lights, width)
  std::vector<std::uint8_t> is_lit;  ///< (2 n_lights)
  std::vector<std::uint16_t> lit;    ///< indices with a factor, ascending
  [[nodiscard]] bool has_plate() const {
    return std::any_of(queries.begin(), queries.end(), [](const LightQuery* query) {
      return std::any_of(query->plate.begin(), query->plate.end(),
                         [](double f) { return f != 0.0; });
    });
  }
};

PreparedBasis::Memory::Memory(std::uint64_t bytes)
    : buffer(bytes),
      resource(std::make_unique<std::pmr::monotonic_buffer_resource>(buffer.bytes().data(),
                                                                     buffer.bytes().size())) {}

PreparedBasis::PreparedBasis(const BasisFile& basis, const PrepareOptions& options)
    : name_(basis.name()), header_(basis.header()), tables_(basis.tables()) {
  const bool is_quantised = header_.coding == BasisCoding::quantised;
  const bool is_wide = header_.dims.n_lights > kMostLights;
  if (options.form == PreparedForm::sparse && (!is_quantised || is_wide)) {
    throw Error(is_wide ? fmt::format("the sparse form takes up to {} lights", kMostLights)
                        : std::string("an exact basis file has no sparse form"),
                name_, "prepare the dense form");
  }
  const bool is_dense = options.form == PreparedForm::dense ||
                        (options.form == PreparedForm::automatic &&
                         (!is_quantised || is_wide ||
                          header_.mean_coefficients > kDenseFraction * header_.dims.n_lights));
  if (is_dense) {
    dense_.emplace(BasisSource(basis), name_, HalfOptions{{}, options.memory_bytes});
    bytes_ = dense_->report().bytes;
    return;
  }
  unpack(basis, options.memory_bytes);
  measure_products(options.bound_products);
}

/// squares[j] += ||gain u_j||^2 of one tile.
void PreparedBasis::add_plate_squares(const SparseTile& tile, const TileRect& rect,
                                      std::span<double> squares) const {
  if (tile.plate.empty()) {
    return;
  }
  std::vector<double> alone(squares.size());
  std::vector<double> direction(tile.n_pixels);
  for (std::size_t j = 0; j < squares.size(); ++j) {
    alone[j] = 1.0;
    plate_sums(rect, header_.plate_degree, tile.plate, alone, direction);
    alone[j] = 0.0;
    for (std::size_t p = 0; p < tile.n_pixels; ++p) {
      const double value = direction[p] * tile.gain[p];
      squares[j] += value * value;
    }
  }
}

void PreparedBasis::unpack(const BasisFile& basis, std::uint64_t memory_bytes) {
  const std::size_t channels = count(header_.dims.channels);
  const std::size_t n_indices = 2 * count(header_.dims.n_lights);
  const std::size_t rank = count(header_.plate_rank);
  if (sparse_bytes(header_) > static_cast<double>(memory_bytes)) {
    throw Error(
        fmt::format("the basis takes more than {} bytes of memory unpacked", memory_bytes),
        name_, "give more memory, or relight from the file");
  }
  for (int t = 0; t < basis.n_tiles(); ++t) {
    rects_.push_back(basis.tile_rect(t));
  }
  tiles_.reserve(rects_.size() * channels);
  const std::size_t n_tiles = rects_.size() * channels;
  for (std::size_t first = 0; first < n_tiles; first += kTilesAtOnce) {
    std::vector<SparseTile> unpacked(std::min(kTilesAtOnce, n_tiles - first));
    parallel_for(unpacked.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        unpacked[i] = unpack_tile(basis, static_cast<int>((first + i) / channels),
                                  static_cast<int>((first + i) % channels));
      }
    });
    // Contiguous, in the order they are read.
    std::uint64_t of_rows = 0;
    std::uint64_t of_lists = 0;
    for (const SparseTile& tile : unpacked) {
      of_rows += tile.room_of_rows();
      of_lists += tile.room_of_lists();
    }
    std::pmr::memory_resource* rows = memory_.emplace_back(of_rows).resource.get();
    std::pmr::memory_resource* lists = memory_.emplace_back(of_lists).resource.get();
    for (const SparseTile& tile : unpacked) {
      tiles_.emplace_back(tile, rows, lists);
    }
  }
  list_lengths_.assign(channels * n_indices, 0);
  row_entries_.assign(channels, 0);
  longest_rows_.assign(channels, 0);
  plate_norms_.assign(channels * rank, 0.0);
  for (std::size_t i = 0; i < tiles_.size(); ++i) {
    const SparseTile& tile = tiles_[i];
    const std::size_t c = i % channels;
    bytes_ += tile.row_bytes() + tile.list_bytes() + tile.pixel_bytes();
    row_entries_[c] += tile.blocks.size() * 8;
    longest_rows_[c] = std::max(longest_rows_[c], tile.longest_row);
    for (std::size_t l = 0; l < tile.list_index.size(); ++l) {
      list_lengths_[c * n_indices + tile.list_index[l]] += tile.list(l).size();
    }
    add_plate_squares(tile, rects_[i / channels],
                      std::span(plate_norms_).subspan(c * rank, rank));
  }
  for (double& norm : plate_norms_) {
    norm = std::sqrt(norm);
  }
}

/// Products of the coefficients' pictures, grid by grid: with them the norm of any sum of
/// pictures is known, where the triangle inequality is 5 to 10 times too large.
void PreparedBasis::measure_products(double most) {
  const int n_lights = header_.dims.n_lights;
  const std::size_t channels = count(header_.dims.channels);
  const std::size_t per_grid = count(header_.n_grids() > 0 ? header_.grid.size() : n_lights);
  const std::size_t n_grids = count(n_lights) / per_grid;
  double work = 0.0;
  for (const SparseTile& tile : tiles_) {
    for (std::size_t slot = 0; slot + 1 < tile.row_starts.size(); ++slot) {
      const double length = tile.row_starts[slot + 1] - tile.row_starts[slot];
      work += 0.5 * 8.0 * length * length;
    }
  }
  // The memory of the sums is bounded along with the work: 8 partial sums of n^4 doubles.
  if (work > most || double(per_grid * per_grid) > 0x1p22) {
    return;
  }
  const std::size_t n_products = per_grid * per_grid;
  products_.resize(channels * n_grids * n_products);
  norms_.resize(channels * count(n_lights));
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t g = 0; g < n_grids; ++g) {
      const std::vector<double> sums = grid_products(static_cast<int>(c), g, per_grid);
      double* norms = norms_.data() + c * count(n_lights) + g * per_grid;
      for (std::size_t i = 0; i < per_grid; ++i) {
        norms[i] = std::sqrt(sums[i * per_grid + i]);
      }
      float* to = products_.data() + (c * n_grids + g) * n_products;
      for (std::size_t i = 0; i < per_grid; ++i) {
        for (std::size_t j = i; j < per_grid; ++j) {
          const double scale = norms[i] * norms[j];
          to[i * per_grid + j] = to[j * per_grid + i] =
              scale > 0.0 ? static_cast<float>(sums[i * per_grid + j] / scale) : 0.0F;
        }
      }
    }
  }
  bytes_ += products_.size() * sizeof(float);
}

/// <C_i, C_j> for i <= j of one grid, (per_grid, per_grid).
std::vector<double> PreparedBasis::grid_products(int channel, std::size_t grid,
                                                 std::size_t per_grid) const {
  std::vector<std::vector<double>> parts(kTileParts);
  parallel_for(kTileParts, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t part = begin; part < end; ++part) {
      parts[part].assign(per_grid * per_grid, 0.0);
      for (std::size_t t = part; t < rects_.size(); t += kTileParts) {
        const auto rows = read_rows(tile(t, channel), header_.dims.n_lights, grid, per_grid);
        for (const std::vector<Entry>& entries : rows) {
          for (std::size_t a = 0; a < entries.size(); ++a) {
            double* to = parts[part].data() + entries[a].index * per_grid;
            for (std::size_t b = a; b < entries.size(); ++b) {
              to[entries[b].index] += entries[a].value * entries[b].value;
            }
          }
        }
      }
    }
  });
  for (std::size_t part = 1; part < kTileParts; ++part) {
    std::transform(parts[0].begin(), parts[0].end(), parts[part].begin(), parts[0].begin(),
                   std::plus<>());
  }
  return std::move(parts[0]);
}

/// ||sum of x_i N_i||^2 = x' R x with N_i = C_i / ||C_i||, x_i = l_i ||C_i||, R their products.
/// Rounding R and the sum costs at most 2^-22 (sum |x_i|)^2, which is added; the norms of
/// different grids are added.
std::vector<double> PreparedBasis::sharper_tails(const LightQuery& query,
                                                 std::span<const int> ranked) const {
  constexpr double kRounding = 0x1p-22;
  const std::size_t n_lights = query.light.size();
  const std::size_t per_grid = header_.n_grids() > 0 ? count(header_.grid.size()) : n_lights;
  const std::size_t n_grids = n_lights / per_grid;
  std::vector<double> sums(n_lights);  // R x
  std::vector<double> square(n_grids);
  std::vector<double> absolute(n_grids);
  std::vector<double> bounds(n_grids);
  std::vector<double> tails(ranked.size() + 1, 0.0);
  for (std::size_t r = ranked.size(); r-- > 0;) {
    const std::size_t i = count(ranked[r]);
    const std::size_t g = i / per_grid;
    const double x =
        query.light[i] * header_.step * norms_[count(query.channel) * n_lights + i];
    const float* row = products_.data() +
                       (count(query.channel) * n_grids + g) * per_grid * per_grid +
                       i % per_grid * per_grid;
    double* to = sums.data() + g * per_grid;
    square[g] += 2.0 * x * to[i % per_grid] + x * x;
    absolute[g] += std::abs(x);
    for (std::size_t k = 0; k < per_grid; ++k) {
      to[k] += x * double{row[k]};
    }
    bounds[g] = std::sqrt(std::max(0.0, square[g]) + kRounding * absolute[g] * absolute[g]);
    tails[r] = std::accumulate(bounds.begin(), bounds.end(), 0.0);
  }
  return tails;
}

const SparseTile& PreparedBasis::tile(std::size_t i_tile, int channel) const {
  return tiles_[i_tile * count(header_.dims.channels) + count(channel)];
}

PreparedBasis::Chunk PreparedBasis::make_chunk(std::vector<const LightQuery*> queries,
                                               std::optional<RelightMethod> method) const {
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t first = count(queries.front()->channel) * 2 * n_lights;
  Chunk chunk;
  chunk.queries = std::move(queries);
  chunk.width = chunk.queries.size() == 1 ? 1 : kBatch;
  chunk.light.assign(2 * n_lights * chunk.width, 0.0F);
  for (std::size_t q = 0; q < chunk.queries.size(); ++q) {
    const LightQuery& query = *chunk.queries[q];
    // One unit for the factors of coefficients and gains.
    const int exponent = unit_exponent(factors_of(query));
    chunk.exponents.push_back(exponent);
    for (std::size_t i = 0; i < n_lights; ++i) {
      const float factor = in_units(header_.step * query.light[i], exponent);
      chunk.light[i * chunk.width + q] = factor;
      chunk.light[(n_lights + i) * chunk.width + q] = 65536.0F * factor;
    }
  }
  std::uint64_t touched = 0;
  chunk.is_lit.assign(2 * n_lights, 0);
  for (std::size_t i = 0; i < 2 * n_lights; ++i) {
    const auto from = chunk.light.begin() + static_cast<std::ptrdiff_t>(i * chunk.width);
    if (list_lengths_[first + i] > 0 &&
        std::any_of(from, from + static_cast<std::ptrdiff_t>(chunk.width),
                    [](float f) { return f != 0.0F; })) {
      chunk.lit.push_back(static_cast<std::uint16_t>(i));
      chunk.is_lit[i] = 1;
      touched += list_lengths_[first + i];
    }
  }
  const bool is_batch = chunk.width > 1;
  const double rows = static_cast<double>(row_entries_[count(chunk.queries.front()->channel)]) *
                      (is_batch ? kBatchRowCost : kRowCost);
  const double lists = static_cast<double>(touched) * (is_batch ? kBatchListCost : kListCost);
  chunk.method = method.value_or(lists < rows ? RelightMethod::coefficient_lists
                                              : RelightMethod::sparse_rows);
  return chunk;
}

std::vector<double> PreparedBasis::factors_of(const LightQuery& query) const {
  std::vector<double> factors(query.plate);
  for (const double l : query.light) {
    factors.push_back(header_.step * l);
  }
  return factors;
}

/// A value passes the rounding of its factor and its product, one addition per entry of the
/// pixel, the last one and the picture's own. The plate's sums are double: they pass only the
/// last two.
double PreparedBasis::rounding(const LightQuery& query, int exponent) const {
  constexpr int kOthers = 6;
  constexpr double kSplit = 3.0;  // |high part| + |low part| <= 3 |value|
  const std::size_t n_lights = query.light.size();
  const auto high_parts =
      list_lengths_.begin() +
      static_cast<std::ptrdiff_t>((2 * count(query.channel) + 1) * n_lights);
  const bool is_split =
      std::any_of(high_parts, high_parts + static_cast<std::ptrdiff_t>(n_lights),
                  [](std::uint64_t length) { return length > 0; });
  const auto n_additions = static_cast<int>(longest_rows_[count(query.channel)]);
  double error = 0.0;
  for (std::size_t i = 0; i < n_lights; ++i) {
    error += float_sum_error(header_.step * query.light[i], exponent, n_additions + kOthers) /
             header_.step *
             double{tables_.coefficient_norms[count(query.channel) * n_lights + i]};
  }
  error *= is_split ? kSplit : 1.0;
  const std::size_t rank = query.plate.size();
  for (std::size_t j = 0; j < rank; ++j) {
    error += float_sum_error(query.plate[j], exponent, kOthers) *
             plate_norms_[count(query.channel) * rank + j];
  }
  return error;
}

std::uint64_t PreparedBasis::sum_tile(std::size_t i_tile, int channel, const Chunk& chunk,
                                      KernelCode code,
                                      std::vector<RelitPicture>& pictures) const {
  const SparseTile& from = tile(i_tile, channel);
  const bool has_plate = chunk.has_plate() && !from.plate.empty();
  const bool has_terms = !chunk.lit.empty() && !from.entries.empty();
  if (!has_plate && !has_terms) {
    return 0;
  }
  std::uint64_t bytes = from.pixel_bytes();
  std::vector<float> sums(from.n_pixels * chunk.width);
  if (has_terms && chunk.method == RelightMethod::sparse_rows) {
    bytes += from.row_bytes();
    if (chunk.width == 1) {
      sum_rows(code, from.rows(), chunk.light, sums);
    } else {
      sum_rows_batch(code, from.rows(), chunk.light, sums);
    }
  } else if (has_terms) {
    const auto add = [&](std::size_t l) {
      const auto list = from.list(l);
      bytes += list.size_bytes();
      const auto factors =
          std::span(chunk.light).subspan(from.list_index[l] * chunk.width, chunk.width);
      if (chunk.width == 1) {
        add_list(list, factors[0], sums);
      } else {
        add_list_batch(code, list, factors, sums);
      }
    };
    if (chunk.lit.size() > from.list_index.size() / kSearchCost) {
      for (std::size_t l = 0; l < from.list_index.size(); ++l) {
        if (chunk.is_lit[from.list_index[l]] != 0) {
          add(l);
        }
      }
    } else {
      auto at = from.list_index.begin();
      for (const std::uint16_t index : chunk.lit) {
        at = std::lower_bound(at, from.list_index.end(), index);
        if (at != from.list_index.end() && *at == index) {
          add(static_cast<std::size_t>(at - from.list_index.begin()));
        }
      }
    }
  }
  std::vector<float> column(chunk.width == 1 ? 0 : from.n_pixels);
  std::vector<double> plate(has_plate ? from.n_pixels : 0);
  std::vector<double> factors;
  for (std::size_t q = 0; q < chunk.queries.size(); ++q) {
    const LightQuery& query = *chunk.queries[q];
    if (chunk.width == 1) {
      column.swap(sums);
    } else {
      for (std::size_t p = 0; p < column.size(); ++p) {
        column[p] = sums[p * chunk.width + q];
      }
    }
    for (std::size_t p = 0; p < from.scales.size(); ++p) {
      column[p] *= from.scales[p];
    }
    if (has_plate) {
      factors = query.plate;
      for (double& factor : factors) {
        factor = std::ldexp(factor, -chunk.exponents[q]);
      }
      plate_sums(rects_[i_tile], header_.plate_degree, from.plate, factors, plate);
      for (std::size_t p = 0; p < column.size(); ++p) {
        column[p] = static_cast<float>(plate[p] * from.gain[p] + double{column[p]});
      }
    }
    put_sums(column, 1, chunk.exponents[q], rects_[i_tile], query, pictures);
  }
  return bytes;
}

std::vector<RelitPicture> PreparedBasis::sum(const LightQueries& requested,
                                             PreparedRun& run) const {
  std::vector<RelitPicture> pictures = requested.black_pictures(std::move(run.reuse));
  run.reuse.clear();
  std::vector<double> rounding_squares(pictures.size());
  std::vector<Chunk> chunks;
  for (int c = 0; c < header_.dims.channels; ++c) {
    for (std::vector<const LightQuery*>& queries : batches_of_channel(requested, c)) {
      chunks.push_back(make_chunk(std::move(queries), run.method));
    }
  }
  for (const Chunk& chunk : chunks) {
    for (std::size_t q = 0; q < chunk.queries.size(); ++q) {
      const LightQuery& query = *chunk.queries[q];
      const double error = rounding(query, chunk.exponents[q]);
      rounding_squares[count(query.environment)] += error * error;
      pictures[count(query.environment)].method = to_string(chunk.method);
    }
  }
  std::vector<std::uint64_t> bytes(rects_.size());
  parallel_for(rects_.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      for (const Chunk& chunk : chunks) {
        bytes[t] += sum_tile(t, chunk.queries.front()->channel, chunk, run.code, pictures);
      }
    }
  });
  const std::uint64_t bytes_read =
      std::accumulate(bytes.begin(), bytes.end(), std::uint64_t{0});
  for (std::size_t e = 0; e < pictures.size(); ++e) {
    pictures[e].bound.rounding = std::sqrt(rounding_squares[e]);
    pictures[e].bytes_read = bytes_read;
  }
  requested.finish(pictures);
  return pictures;
}

/// The half floats hold what the file decodes to: their error and the file's add up. Decoding
/// rounds coefficients and values to float: at most 2^-24 of their norm each, and the
/// residual's norm is at most twice the stack's.
std::vector<RelitPicture> PreparedBasis::relight_dense(std::span<const LightWeights> weights,
                                                       const RelightOptions& options,
                                                       PreparedRun run) const {
  if (options.terms) {
    throw Error("the dense form sums all lights and knows no terms", name_,
                "prepare the sparse form, or relight from the file");
  }
  const LightQueries requested(header_, tables_, name_, weights);
  const double decoded =
      header_.coding == BasisCoding::quantised
          ? 0x1p-22 * (1.0 + header_.achieved.relative_l2) * header_.stack_norm
          : 0.0;
  std::vector<RelitPicture> pictures = dense_->relight(weights, run.code, std::move(run.reuse));
  for (std::size_t e = 0; e < pictures.size(); ++e) {
    requested.add_coded(e, decoded * weights[e].norm(), pictures[e].bound);
  }
  return pictures;
}

std::vector<RelitPicture> PreparedBasis::relight(std::span<const LightWeights> weights,
                                                 const RelightOptions& options,
                                                 PreparedRun run) const {
  HAARLIGHT_EXPECTS(!run.method || (*run.method == RelightMethod::dense_half) ==
                                       (form() == PreparedForm::dense),
                    "a method of the form that was prepared");
  if (dense_) {
    return relight_dense(weights, options, std::move(run));
  }
  TailBound tail_bound;
  if (has_sharp_bound()) {
    tail_bound = [this](const LightQuery& query, std::span<const int> ranked) {
      return sharper_tails(query, ranked);
    };
  }
  LightQueries requested(header_, tables_, name_, weights, std::move(tail_bound));
  return relight_as_requested(requested, options, [&] { return sum(requested, run); });
}

}  // namespace haarlight::relight
