// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/relight_pilot.h"

#include <algorithm>
#include <limits>
#include <memory_resource>
#include <numeric>

#include "core/count.h"
#include "core/cpu_time.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/sparse_tile.h"
#include "relight/basis/dense_half.h"
#include "relight/basis/relight_kernels.h"

namespace haarlight::relight {

namespace {

/// Of each coefficient, by light-domain index.
std::vector<int> groups_of(const BasisFile& basis) {
  std::vector<int> groups(basis.order().size());
  for (int g = 0; g < basis.n_groups(); ++g) {
    for (int i = basis.group_begin(g); i < basis.group_end(g); ++i) {
      groups[count(basis.order()[count(i)])] = g;
    }
  }
  return groups;
}

/// Seconds of sums over one tile's coefficients, as prepared_basis.cpp makes them.
struct TileTimes {
  double unpack = 0.0;
  double rows = 0.0;              ///< one pass for `width` pictures
  double lists = 0.0;             ///< the same, all lists
  std::vector<double> entries{};  ///< (n_lights)
};

TileTimes time_tile(const BasisFile& basis, int i_tile, int channel, std::size_t width) {
  const std::size_t n_lights = count(basis.header().dims.n_lights);
  const KernelCode code = best_kernel_code();
  TileTimes times;
  double last = thread_cpu_seconds();
  const auto lap = [&last] {
    const double before = last;
    last = thread_cpu_seconds();
    return last - before;
  };
  std::pmr::memory_resource* const memory = std::pmr::new_delete_resource();
  const SparseTile tile(unpack_tile(basis, i_tile, channel), memory, memory);
  times.unpack = lap();
  const std::vector<float> light(2 * n_lights * width, 1.0F);
  std::vector<float> sums(tile.n_pixels * width);
  lap();
  if (width == 1) {
    sum_rows(code, tile.rows(), light, sums);
  } else {
    sum_rows_batch(code, tile.rows(), light, sums);
  }
  times.rows = lap();
  for (std::size_t l = 0; l < tile.list_index.size(); ++l) {
    const auto factors = std::span(light).subspan(tile.list_index[l] * width, width);
    if (width == 1) {
      add_list(tile.list(l), factors[0], sums);
    } else {
      add_list_batch(code, tile.list(l), factors, sums);
    }
  }
  times.lists = lap();
  times.entries.resize(n_lights);
  for (std::size_t l = 0; l < tile.list_index.size(); ++l) {
    times.entries[tile.list_index[l] % n_lights] += static_cast<double>(tile.list(l).size());
  }
  return times;
}

/// Bytes of a channel's coefficients.
double bytes_of(const BasisFile& basis, int i_tile, int channel) {
  double bytes = 0.0;
  for (int g = 0; g < basis.n_groups(); ++g) {
    bytes += basis.group_bytes(i_tile, channel, g);
  }
  return bytes;
}

/// One tile of a file as a stack of its own.
class TileOfBasis final : public StackSource {
 public:
  TileOfBasis(const BasisFile& basis, int tile) : all_(basis), at_(basis.tile_rect(tile)) {}
  [[nodiscard]] StackDims dims() const override {
    StackDims dims = all_.dims();
    dims.width = at_.width;
    dims.height = at_.height;
    return dims;
  }
  void read_tile(const TileRect& rect, std::span<float> out) const override {
    all_.read_tile({at_.x0 + rect.x0, at_.y0 + rect.y0, rect.width, rect.height}, out);
  }

 private:
  BasisSource all_;
  TileRect at_;
};

/// costs[K] is what the K-th term adds: to what the first K take.
std::vector<double> added_up(std::vector<double> costs) {
  std::partial_sum(costs.begin(), costs.end(), costs.begin());
  return costs;
}

}  // namespace

std::vector<int> pilot_tiles(const BasisFile& basis) {
  constexpr int kFraction = 32;
  constexpr int kMost = 64;
  constexpr int kFewest = 4;  // of small files a sixteenth
  const int n = std::clamp(basis.n_tiles() / kFraction,
                           std::clamp(2 * basis.n_tiles() / kFraction, 1, kFewest), kMost);
  std::vector<int> tiles;
  tiles.reserve(count(n));
  for (int i = 0; i < n; ++i) {  // in the middle of each of n parts
    tiles.push_back(
        static_cast<int>((2 * std::int64_t{i} + 1) * basis.n_tiles() / (std::int64_t{2} * n)));
  }
  return tiles;
}

double pilot_share(const BasisFile& basis, std::span<const int> tiles) {
  std::uint64_t summed = 0;
  for (const int t : tiles) {
    summed += 2 * static_cast<std::uint64_t>(basis.tile_rect(t).n_pixels());
  }
  return double(summed) / double(basis.header().dims.n_pixels());
}

MemoryCost pilot_memory(const BasisFile& basis, int n_pictures, std::span<const int> tiles) {
  HAARLIGHT_EXPECTS(n_pictures > 0 && !tiles.empty(), "a picture and a tile");
  const std::size_t width = n_pictures == 1 ? 1 : kBatch;
  const int n_batches = (n_pictures + kBatch - 1) / kBatch;
  const double of_batch = width == 1 ? 1.0 : double(n_batches) / n_pictures;
  MemoryCost cost;
  for (int c = 0; c < basis.header().dims.channels; ++c) {
    double all = 0.0;
    for (int t = 0; t < basis.n_tiles(); ++t) {
      all += bytes_of(basis, t, c);
    }
    double timed = 0.0;
    TileTimes sum;
    sum.entries.resize(count(basis.header().dims.n_lights));
    for (const int t : tiles) {
      timed += bytes_of(basis, t, c);
      const TileTimes one = time_tile(basis, t, c, width);
      sum.unpack += one.unpack;
      sum.rows += one.rows;
      sum.lists += one.lists;
      std::transform(one.entries.begin(), one.entries.end(), sum.entries.begin(),
                     sum.entries.begin(), std::plus<>());
    }
    const double scale =
        timed > 0.0 ? all / timed : double(basis.n_tiles()) / double(tiles.size());
    const double entries = std::accumulate(sum.entries.begin(), sum.entries.end(), 0.0);
    cost.unpack += scale * sum.unpack;
    cost.rows.push_back(scale * sum.rows * of_batch);
    for (const double of_term : sum.entries) {
      cost.term.push_back(entries > 0.0 ? scale * sum.lists * of_batch * of_term / entries
                                        : 0.0);
    }
  }
  return cost;
}

HalfCost pilot_half(const BasisFile& basis, std::span<const LightWeights> weights, int tile) {
  HAARLIGHT_EXPECTS(!weights.empty(), "a picture");
  const double scale =
      double(basis.header().dims.n_pixels()) / basis.tile_rect(tile).n_pixels();
  HalfCost cost;
  const double start = thread_cpu_seconds();
  const DenseHalf half(TileOfBasis(basis, tile), basis.name());
  const double stored = thread_cpu_seconds();
  const std::vector<RelitPicture> pictures = half.relight(weights);
  cost.picture = scale * (thread_cpu_seconds() - stored) / double(weights.size());
  cost.store = scale * (stored - start);
  for (const RelitPicture& picture : pictures) {
    cost.error = std::max(cost.error, picture.bound.relative_l2);
  }
  return cost;
}

std::vector<double> file_seconds_by_terms(const BasisFile& basis, const FilePassCost& cost,
                                          LightQueries& queries, int environment,
                                          TermOrder order, double shared_by) {
  const std::vector<int> groups = groups_of(basis);
  std::vector<double> added(1, cost.pixels / shared_by);
  constexpr std::size_t kNever = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> first(cost.unpack.size(), kNever);  // term that needs it
  for (std::size_t q = 0; q < queries.queries().size(); ++q) {
    const LightQuery& query = queries.queries()[q];
    if (query.environment != environment) {
      continue;
    }
    added[0] += cost.picture;
    const std::vector<int>& ranked = queries.ranked(q, order);
    added.resize(std::max(added.size(), ranked.size() + 1));
    for (std::size_t r = 0; r < ranked.size(); ++r) {
      const std::size_t part =
          count(query.channel) * count(cost.n_groups) + count(groups[count(ranked[r])]);
      added[r + 1] += cost.term[count(query.channel) * query.light.size() + count(ranked[r])];
      first[part] = std::min(first[part], r + 1);
    }
  }
  for (std::size_t part = 0; part < first.size(); ++part) {
    if (first[part] != kNever) {
      added[first[part]] += cost.unpack[part] / shared_by;
    }
  }
  return added_up(std::move(added));
}

std::vector<double> memory_seconds_by_terms(const MemoryCost& cost, double picture,
                                            LightQueries& queries, int environment,
                                            TermOrder order) {
  std::vector<double> seconds(1);
  for (std::size_t q = 0; q < queries.queries().size(); ++q) {
    const LightQuery& query = queries.queries()[q];
    if (query.environment != environment) {
      continue;
    }
    const std::vector<int>& ranked = queries.ranked(q, order);
    std::vector<double> lists(1, 0.0);
    for (const int i : ranked) {
      lists.push_back(cost.term[count(query.channel) * query.light.size() + count(i)]);
    }
    lists = added_up(std::move(lists));
    const std::size_t before = seconds.size();
    seconds.resize(std::max(before, lists.size()), seconds.back());
    for (std::size_t k = 0; k < seconds.size(); ++k) {  // the cheaper of the two ways
      seconds[k] += picture + std::min(lists[std::min(k, lists.size() - 1)],
                                       cost.rows[count(query.channel)]);
    }
  }
  return seconds;
}

}  // namespace haarlight::relight
