// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/relight.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "core/count.h"
#include "core/cpu_time.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/light_query.h"
#include "relight/basis/plate/tile_plate.h"
#include "relight/basis/relight_pilot.h"
#include "relight/basis/resident_basis.h"

namespace haarlight::relight {

namespace {

/// A coefficient, or a light, that a sum needs.
struct Lit {
  std::size_t index = 0;  ///< within its group
  double factor = 0.0;
};

// The first finds fresh memory and cold caches, the second neither: the whole file is in between.
constexpr int kPilotTurns = 2;

/// CPU seconds of the parts of a sum; (channels, groups) each.
struct PartSeconds {
  std::vector<double> unpack;
  std::vector<double> products;
  std::vector<double> entries;  ///< (channels, coefficients): how many, no seconds
  double pixels = 0.0;
  double pictures = 0.0;
};

/// Attributes the time since the last mark to a part; nothing without parts.
class Stopwatch {
 public:
  explicit Stopwatch(PartSeconds* parts) : parts_(parts) { mark_now(); }
  void add_unpack(std::size_t group) { add(&PartSeconds::unpack, group); }
  void add_products(std::size_t group) { add(&PartSeconds::products, group); }
  void add_pixels() { add(&PartSeconds::pixels); }
  void add_pictures() { add(&PartSeconds::pictures); }
  [[nodiscard]] bool is_timing() const noexcept { return parts_ != nullptr; }
  void count_entry(std::size_t coefficient) { parts_->entries[coefficient] += 1.0; }
  void leave_out() { mark_now(); }

 private:
  void mark_now() { last_ = parts_ == nullptr ? 0.0 : thread_cpu_seconds(); }
  [[nodiscard]] double lap() {
    const double before = last_;
    mark_now();
    return last_ - before;
  }
  void add(std::vector<double> PartSeconds::*part, std::size_t i) {
    if (parts_ != nullptr) {
      (parts_->*part)[i] += lap();
    }
  }
  void add(double PartSeconds::*part) {
    if (parts_ != nullptr) {
      parts_->*part += lap();
    }
  }

  PartSeconds* parts_;
  double last_ = 0.0;
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
  [[nodiscard]] std::size_t n_queries() const noexcept { return queries_.size(); }
  [[nodiscard]] std::vector<RelitPicture> sum();
  /// What some tiles take.
  /// @param energies  (tiles, environments): of each tile's pixels, all colours
  [[nodiscard]] PartSeconds time_tiles(std::span<const int> tiles,
                                       std::vector<std::vector<double>>& energies);
  /// The terms of each picture that are predicted to keep the error, by sums of a few tiles.
  [[nodiscard]] std::vector<int> predict_terms(double max_error, TermOrder order);
  /// Coefficients, or lights, that the colours of all pictures need of a group.
  [[nodiscard]] std::size_t n_lit(int channel, int group) const;
  /// Colours of pictures that need a coefficient, by light-domain index.
  [[nodiscard]] double n_lit_by(int channel, std::size_t index) const;

 private:
  void prepare();
  void find_lit();
  [[nodiscard]] std::vector<double> tile_energies(int i_tile, Stopwatch& watch) const;
  void sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                std::vector<std::uint64_t>& bytes) const;
  [[nodiscard]] std::vector<std::vector<double>> tile_sums(int i_tile, Stopwatch& watch) const;
  void sum_quantised(int i_tile, const TileRect& rect, int channel,
                     std::vector<std::vector<double>>& sums, Stopwatch& watch) const;
  void sum_group(int i_tile, std::size_t n_pixels, int channel, int group,
                 std::vector<std::vector<double>>& sums, Stopwatch& watch) const;
  void sum_integers(int i_tile, int channel, std::vector<std::vector<double>>& sums,
                    Stopwatch& watch) const;
  void sum_lossless(int i_tile, const TileRect& rect, int channel,
                    std::vector<std::vector<double>>& sums, Stopwatch& watch) const;
  void sum_lights(std::span<const float> rows, std::size_t n_pixels, int channel, int group,
                  std::vector<std::vector<double>>& sums) const;
  [[nodiscard]] std::size_t part(int channel, int group) const {
    return count(channel) * count(basis_.n_groups()) + count(group);
  }
  [[nodiscard]] bool is_group_needed(int channel, int group) const {
    return needed_[part(channel, group)] != 0;
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
                           std::vector<std::vector<double>>& sums, Stopwatch& watch) const {
  const ResidentBasis::Coefficients* held =
      resident_ == nullptr ? nullptr : &resident_->coefficients(i_tile, channel, group);
  const SparseBlock block =
      held == nullptr ? basis_.sparse(i_tile, channel, group) : SparseBlock{};
  watch.add_unpack(part(channel, group));
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
  watch.add_products(part(channel, group));
  if (watch.is_timing()) {
    const std::size_t first = count(channel) * count(basis_.header().dims.n_lights) +
                              count(basis_.group_begin(group));
    for (const std::uint32_t cell : block.cell) {
      watch.count_entry(first + cell / n_pixels);
    }
    watch.leave_out();
  }
}

void Relighting::sum_quantised(int i_tile, const TileRect& rect, int channel,
                               std::vector<std::vector<double>>& sums, Stopwatch& watch) const {
  const std::size_t n_pixels = count(rect.n_pixels());
  for (int g = 0; g < basis_.n_groups(); ++g) {
    if (!basis_.is_group_empty(i_tile, channel, g) && is_group_needed(channel, g)) {
      sum_group(i_tile, n_pixels, channel, g, sums, watch);
    }
  }
  const PixelBlock read = resident_ == nullptr ? basis_.pixels(i_tile, channel) : PixelBlock{};
  const PixelBlock& pixels = resident_ == nullptr ? read : resident_->pixels(i_tile, channel);
  watch.add_pixels();
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
  watch.add_pictures();
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
                              std::vector<std::vector<double>>& sums, Stopwatch& watch) const {
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
      const std::vector<float> rows = basis_.floats(i_tile, channel, g);
      watch.add_unpack(part(channel, g));
      sum_lights(rows, n_pixels, channel, g, sums);
    }
    watch.add_products(part(channel, g));
  }
}

/// Integers can only be decoded for all lights at once.
void Relighting::sum_integers(int i_tile, int channel, std::vector<std::vector<double>>& sums,
                              Stopwatch& watch) const {
  const bool is_wanted =
      std::any_of(queries_.begin(), queries_.end(),
                  [&](const LightQuery& q) { return q.channel == channel && q.terms > 0; });
  if (!is_wanted) {
    return;
  }
  const std::vector<float> values = basis_.decode_tile(i_tile, channel);
  watch.add_unpack(part(channel, 0));
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
  watch.add_products(part(channel, 0));
}

/// (queries, pixels) of a tile.
std::vector<std::vector<double>> Relighting::tile_sums(int i_tile, Stopwatch& watch) const {
  const BasisHeader& header = basis_.header();
  const TileRect rect = basis_.tile_rect(i_tile);
  std::vector<std::vector<double>> sums(queries_.size(),
                                        std::vector<double>(count(rect.n_pixels())));
  watch.add_pictures();
  for (int c = 0; c < header.dims.channels; ++c) {
    if (header.coding == BasisCoding::quantised) {
      sum_quantised(i_tile, rect, c, sums, watch);
    } else if (header.coding == BasisCoding::integers && resident_ == nullptr) {
      sum_integers(i_tile, c, sums, watch);
    } else {
      sum_lossless(i_tile, rect, c, sums, watch);
    }
  }
  return sums;
}

void Relighting::sum_tile(int i_tile, std::vector<RelitPicture>& pictures,
                          std::vector<std::uint64_t>& bytes) const {
  const TileRect rect = basis_.tile_rect(i_tile);
  Stopwatch untimed(nullptr);
  const std::vector<std::vector<double>> sums = tile_sums(i_tile, untimed);
  for (int c = 0; c < basis_.header().dims.channels; ++c) {
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

void Relighting::prepare() {
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
}

std::size_t Relighting::n_lit(int channel, int group) const {
  std::size_t n = 0;
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    n += queries_[q].channel == channel ? lit(q, group).size() : 0;
  }
  return n;
}

double Relighting::n_lit_by(int channel, std::size_t index) const {
  double n = 0.0;
  for (const LightQuery& query : queries_) {
    n += query.channel == channel && query.light[index] != 0.0 ? 1.0 : 0.0;
  }
  return n;
}

/// (environments): of the tile's pixels, all colours.
std::vector<double> Relighting::tile_energies(int i_tile, Stopwatch& watch) const {
  const std::vector<std::vector<double>> sums = tile_sums(i_tile, watch);
  std::vector<double> found(requested_.n_environments());
  for (std::size_t q = 0; q < queries_.size(); ++q) {
    for (const double sum : sums[q]) {
      found[count(queries_[q].environment)] += sum * sum;
    }
  }
  watch.add_pictures();
  return found;
}

PartSeconds Relighting::time_tiles(std::span<const int> tiles,
                                   std::vector<std::vector<double>>& energies) {
  prepare();
  PartSeconds parts;
  parts.unpack.resize(needed_.size());
  parts.products.resize(needed_.size());
  parts.entries.resize(count(basis_.header().dims.channels) *
                       count(basis_.header().dims.n_lights));
  for (int turn = 0; turn < kPilotTurns; ++turn) {
    energies.clear();
    for (const int tile : tiles) {
      Stopwatch watch(&parts);
      energies.push_back(tile_energies(tile, watch));
    }
  }
  return parts;
}

std::vector<RelitPicture> Relighting::sum() {
  prepare();
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

/// All blocks of a channel's group.
double bytes_of(const BasisFile& basis, std::span<const int> tiles, int channel, int group) {
  double bytes = 0.0;
  for (const int t : tiles) {
    bytes += basis.group_bytes(t, channel, group);
  }
  return bytes;
}

struct GroupProducts {
  int channel = 0;
  int group = 0;
  double seconds = 0.0;
};

/// Gives each coefficient of a group its part of the seconds of all products, by its entries and
/// by as many more as finding them is worth.
void share_products(const BasisFile& basis, const PartSeconds& parts, const Relighting& work,
                    const GroupProducts& products, double search, std::vector<double>& terms) {
  const std::size_t first = count(products.channel) * count(basis.header().dims.n_lights);
  double all = 0.0;
  for (const bool is_known : {false, true}) {
    for (int at = basis.group_begin(products.group); at < basis.group_end(products.group);
         ++at) {
      const std::size_t index = count(basis.order()[count(at)]);
      const double weight = parts.entries[first + count(at)] + search;
      if (is_known) {
        terms[first + index] = all > 0.0 ? products.seconds * weight / all : 0.0;
      } else {
        all += weight * work.n_lit_by(products.channel, index);
      }
    }
  }
}

/// What the tiles took, times the bytes of the file over those of the tiles, or the pixels.
FilePassCost scaled_to_file(const BasisFile& basis, const PartSeconds& parts,
                            std::span<const int> tiles, const Relighting& work) {
  const BasisHeader& header = basis.header();
  std::vector<int> all(count(basis.n_tiles()));
  std::iota(all.begin(), all.end(), 0);
  double n_pixels = 0.0;
  double timed_bytes = 0.0;
  for (const int t : tiles) {
    n_pixels += basis.tile_rect(t).n_pixels();
  }
  constexpr double kTurns = kPilotTurns;
  for (int c = 0; c < header.dims.channels; ++c) {
    for (int g = 0; g < basis.n_groups(); ++g) {
      timed_bytes += work.n_lit(c, g) > 0 ? bytes_of(basis, tiles, c, g) : 0.0;
    }
  }
  const double of_byte =  // where the tiles have nothing of a group
      std::accumulate(parts.unpack.begin(), parts.unpack.end(), 0.0) /
      std::max(kTurns * timed_bytes, 1.0);
  const double of_pixels = double(header.dims.n_pixels()) / (kTurns * n_pixels);
  constexpr double kSearch = 20.0;  // entries of a tile that finding a first one costs
  FilePassCost cost;
  cost.n_groups = basis.n_groups();
  cost.term.resize(parts.entries.size());
  cost.pixels = of_pixels * parts.pixels;
  cost.picture = of_pixels * parts.pictures / double(work.n_queries());
  cost.reading = cost.pixels;
  cost.summing = of_pixels * parts.pictures;
  for (int c = 0; c < header.dims.channels; ++c) {
    for (int g = 0; g < basis.n_groups(); ++g) {
      const std::size_t i = count(c) * count(cost.n_groups) + count(g);
      const double timed = bytes_of(basis, tiles, c, g);
      const double scale =
          timed > 0.0 ? bytes_of(basis, all, c, g) / (kTurns * timed) : of_pixels;
      const std::size_t n_lit = work.n_lit(c, g);
      const double unpack = timed > 0.0 || n_lit == 0 ? scale * parts.unpack[i]
                                                      : of_byte * bytes_of(basis, all, c, g);
      cost.reading += unpack;
      cost.summing += scale * parts.products[i];
      cost.unpack.push_back(unpack);
      share_products(basis, parts, work, {c, g, scale * parts.products[i]},
                     kSearch * double(tiles.size()), cost.term);
    }
  }
  return cost;
}

/// An estimate of a picture's norm from tiles as if they were drawn at random, less twice its
/// standard error: a norm that is too large would let too many terms be dropped, and cost a second
/// sum; one that is too small costs a few terms more.
double careful_norm(const BasisFile& basis, std::span<const int> tiles,
                    const std::vector<std::vector<double>>& energies, std::size_t environment) {
  double sum = 0.0;
  double n_pixels = 0.0;
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    sum += energies[i][environment];
    n_pixels += basis.tile_rect(tiles[i]).n_pixels();
  }
  const double mean = sum / n_pixels;  // of a pixel
  double square = 0.0;
  for (std::size_t i = 0; i < tiles.size(); ++i) {
    const double off = energies[i][environment] - mean * basis.tile_rect(tiles[i]).n_pixels();
    square += off * off;
  }
  const auto n = static_cast<double>(tiles.size());
  const double error = n > 1.0 ? std::sqrt(square * n / (n - 1.0)) / n_pixels : 0.75 * mean;
  return std::sqrt(std::max(mean - 2.0 * error, 0.25 * mean) *
                   double(basis.header().dims.n_pixels()));
}

std::vector<int> Relighting::predict_terms(double max_error, TermOrder order) {
  const std::size_t n = requested_.n_environments();
  constexpr int kFew = 16;  // of so few terms all are taken
  if (basis_.header().coding != BasisCoding::quantised ||
      std::ranges::all_of(queries_, [](const LightQuery& q) { return q.terms_all <= kFew; })) {
    return std::vector<int>(n, basis_.header().dims.n_lights);
  }
  prepare();
  const std::vector<int> tiles = pilot_tiles(basis_);
  std::vector<std::vector<double>> energies(tiles.size());
  parallel_for(tiles.size(), 1, [&](std::size_t begin, std::size_t end) {
    Stopwatch untimed(nullptr);
    for (std::size_t i = begin; i < end; ++i) {
      energies[i] = tile_energies(tiles[i], untimed);
    }
  });
  std::vector<int> terms;
  for (std::size_t e = 0; e < n; ++e) {
    // The picture that is made may lack as much as it drops: (d + c) / (norm - 2 d - c) is kept.
    const double norm = careful_norm(basis_, tiles, energies, e);
    const double coded = requested_.coded(e);
    const double allowed = (max_error * (norm - coded) - coded) / (1.0 + 2.0 * max_error);
    terms.push_back(requested_.terms_within(static_cast<int>(e), allowed, order)
                        .value_or(basis_.header().dims.n_lights));
  }
  return terms;
}

std::vector<RelitPicture> relit(Relighting& work, RelightOptions options) {
  if (options.max_error && !options.terms && options.terms_each.empty()) {
    options.terms_each = work.predict_terms(*options.max_error, options.order);
  }
  return relight_as_requested(work.requested(), options, [&work] { return work.sum(); });
}

}  // namespace

std::vector<RelitPicture> relight(const BasisFile& basis, std::span<const LightWeights> weights,
                                  const RelightOptions& options) {
  Relighting work(basis, weights);
  return relit(work, options);
}

RelitPicture relight(const BasisFile& basis, const LightWeights& weights,
                     const RelightOptions& options) {
  return std::move(relight(basis, std::span(&weights, 1), options).front());
}

std::vector<RelitPicture> relight(const ResidentBasis& basis,
                                  std::span<const LightWeights> weights,
                                  const RelightOptions& options) {
  Relighting work(basis.file(), weights, &basis);
  return relit(work, options);
}

FilePilot pilot_file(const BasisFile& basis, std::span<const LightWeights> weights,
                     std::span<const int> tiles) {
  HAARLIGHT_EXPECTS(!tiles.empty() && !weights.empty(), "a tile and a picture");
  Relighting work(basis, weights);
  std::vector<std::vector<double>> energies;
  const PartSeconds parts = work.time_tiles(tiles, energies);
  FilePilot pilot;
  pilot.cost = scaled_to_file(basis, parts, tiles, work);
  for (std::size_t e = 0; e < weights.size(); ++e) {
    pilot.norms.push_back(careful_norm(basis, tiles, energies, e));
  }
  return pilot;
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
