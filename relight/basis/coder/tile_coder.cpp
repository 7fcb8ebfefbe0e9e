// SPDX-License-Identifier: Apache-2.0
#include "relight/basis/coder/tile_coder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <numeric>
#include <type_traits>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/coefficient_rows.h"
#include "relight/basis/coder/integer_coding.h"
#include "relight/basis/error_gram.h"
#include "relight/basis/plate/plate_gain.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

constexpr double kFloatIsEnough = 1e-4;  // requested errors; floats round to 6e-8 of a value
constexpr int kMaxShift = 40;

/// One coefficient that was kept.
struct Kept {
  std::uint32_t index;
  std::uint32_t pixel;
  std::int32_t value;
};

/// Tile of the file's grid that holds a rectangle within one tile.
TileRect tile_around(const BasisHeader& header, const TileRect& rect) {
  const int x0 = rect.x0 / header.tile * header.tile;
  const int y0 = rect.y0 / header.tile * header.tile;
  return {x0, y0, std::min(header.tile, header.dims.width - x0),
          std::min(header.tile, header.dims.height - y0)};
}

void require_finite(const TileCoding& coding, const TileRect& rect,
                    std::span<const float> values) {
  const auto bad =
      std::find_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
  if (bad == values.end()) {
    return;
  }
  const std::size_t n_lights = count(coding.header.dims.n_lights);
  const auto i = static_cast<std::size_t>(bad - values.begin());
  const std::size_t pixel = i / n_lights % count(rect.n_pixels());
  throw Error(fmt::format("the stack is not finite under light {} at pixel ({}, {})",
                          i % n_lights, rect.x0 + static_cast<int>(pixel % count(rect.width)),
                          rect.y0 + static_cast<int>(pixel / count(rect.width))),
              coding.source,
              "shoot that light again; one such value would spread to every light's picture");
}

constexpr std::size_t kRowsAtOnce = 8;  // pixels whose rows stay in the cache together

/// The clean plate of one channel of a tile, and the gains of its pixels.
template <class Real>
class PixelPlate {
 public:
  /// @param known  what an earlier pass over the same pixels found; null: it is found now
  PixelPlate(const TileCoding& coding, const TileRect& rect, int channel,
             const TilePlateFit* known)
      : coding_(coding),
        rect_(rect),
        tile_(tile_around(coding.header, rect)),
        direction_(count(coding.header.dims.n_lights)) {
    if (!has_plate()) {
      return;
    }
    if (known != nullptr) {
      const std::size_t channels = count(coding.header.dims.channels);
      const std::size_t n = known->plates.size() / channels;
      const auto from = known->plates.begin() + static_cast<std::ptrdiff_t>(count(channel) * n);
      plate_.assign(from, from + static_cast<std::ptrdiff_t>(n));
      const std::size_t n_pixels = count(rect.n_pixels());
      if (known->is_in_floats == std::is_same_v<Real, float> &&
          known->gains.size() == channels * n_pixels) {
        gains_ = std::span(known->gains).subspan(count(channel) * n_pixels, n_pixels);
      }
    } else {
      const int plate_channel = coding.plate->dims().channels == 1 ? 0 : channel;
      plate_ = fit_tile_plate(*coding.plate, plate_channel, tile_, coding.vectors,
                              coding.header.plate_degree);
    }
    terms_ = plate_terms(tile_, coding.header.plate_degree);
    n_terms_ = terms_.size() / count(tile_.n_pixels());
  }

  [[nodiscard]] const std::vector<float>& plate() const { return plate_; }

  /// The pixel's gain, before any step. @param p  of the rectangle
  double fit_gain(std::size_t p, std::span<const float> t) {
    if (!has_plate()) {
      return 0.0;
    }
    look_at(p);
    if (!gains_.empty()) {
      return gains_[p];
    }
    const std::span<const float> direction = floats();
    if (coding_.header.content ==
        BasisContent::plate) {  // the plate itself: its length along the direction
      double along = 0.0;
      double norm = 0.0;
      for (std::size_t k = 0; k < t.size(); ++k) {
        along += double{t[k]} * double{direction[k]};
        norm += double{direction[k]} * double{direction[k]};
      }
      return norm > 0.0 ? along / norm : 0.0;
    }
    return double{gain_(t, direction)};
  }

  /// t - gain * direction; call fit_gain(p, t) first.
  void subtract(std::span<const float> t, double gain, Real* out) const {
    subtract_plate(t, gain, direction_, out);
  }

 private:
  [[nodiscard]] bool has_plate() const { return coding_.vectors.rank > 0; }
  void look_at(std::size_t p) {
    const std::size_t x = p % count(rect_.width) + count(rect_.x0 - tile_.x0);
    const std::size_t y = p / count(rect_.width) + count(rect_.y0 - tile_.y0);
    plate_direction<Real>(
        plate_, std::span(terms_).subspan((y * count(tile_.width) + x) * n_terms_, n_terms_),
        coding_.vectors.vectors, direction_);
  }
  [[nodiscard]] std::span<const float> floats() {
    if constexpr (std::is_same_v<Real, float>) {
      return direction_;
    } else {
      as_float_.assign(direction_.begin(), direction_.end());
      return as_float_;
    }
  }

  const TileCoding& coding_;
  TileRect rect_;
  TileRect tile_;
  std::vector<float> plate_;
  std::span<const double> gains_;  ///< known ones; empty: they are found
  std::vector<double> terms_;
  std::size_t n_terms_ = 1;
  std::vector<Real> direction_;
  std::vector<float> as_float_;
  PlateGain gain_;
};

template <class Real>
double quantisation_error(std::span<const Real> coefficients, double step) {
  const Real inverse = static_cast<Real>(1.0 / step);
  double error = 0.0;
  for (const Real c : coefficients) {
    const double rest = double{c} - step * quantise(c, inverse);
    error += rest * rest;
  }
  return error;
}

/// Sorts by coefficient index, keeping the pixels' order, and packs each group.
std::vector<PackedTile::Block> pack_groups(const std::vector<Kept>& kept,
                                           const TileCoding& coding, std::size_t n_pixels) {
  const BasisHeader& header = coding.header;
  std::vector<std::size_t> start(count(header.dims.n_lights) + 1);
  for (const Kept& k : kept) {
    ++start[k.index + 1];
  }
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<std::uint32_t> first_cell(count(header.dims.n_lights));  // of its group
  std::vector<std::size_t> place(count(header.dims.n_lights));         // the next one's, there
  std::vector<std::size_t> group_of(count(header.dims.n_lights));
  std::vector<SparseBlock> blocks(header.group_ends.size());
  std::size_t begin = 0;
  for (std::size_t g = 0; g < blocks.size(); ++g) {
    const std::size_t end = count(header.group_ends[g]);
    blocks[g].cell.resize(start[end] - start[begin]);
    blocks[g].value.resize(start[end] - start[begin]);
    for (std::size_t i = begin; i < end; ++i) {
      first_cell[i] = static_cast<std::uint32_t>((i - begin) * n_pixels);
      place[i] = start[i] - start[begin];
      group_of[i] = g;
    }
    begin = end;
  }
  for (const Kept& k : kept) {
    SparseBlock& block = blocks[group_of[k.index]];
    const std::size_t to = place[k.index]++;
    block.cell[to] = first_cell[k.index] + k.pixel;
    block.value[to] = k.value;
  }
  std::vector<PackedTile::Block> groups;
  groups.reserve(blocks.size());
  for (SparseBlock& block : blocks) {
    groups.push_back(
        {encode_sparse(block, coding.content), static_cast<std::uint32_t>(block.cell.size())});
    block = {};
  }
  return groups;
}

std::vector<int> positions_of(const BasisHeader& header) {
  const std::vector<int> order = coefficient_order(header);
  std::vector<int> indices(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    indices[count(order[i])] = static_cast<int>(i);
  }
  return indices;
}

/// One pixel's coefficients, in any order. @param step  in units of term_unit()
void add_terms(std::span<const Kept> kept, double step, SparseProducts& products) {
  std::vector<std::pair<int, double>> terms;
  terms.reserve(kept.size());
  for (const Kept& k : kept) {
    terms.emplace_back(static_cast<int>(k.index), step * k.value);
  }
  std::sort(terms.begin(), terms.end());
  std::vector<int> indices;
  std::vector<double> values;
  for (const auto& [index, value] : terms) {
    indices.push_back(index);
    values.push_back(value);
  }
  products.add(indices, values);
}

/// Codes the pixels of one channel, some rows at a time.
template <class Real>
class ChannelCoder {
 public:
  ChannelCoder(const TileCoding& coding, const TileRect& rect, int channel,
               const TilePlateFit* known, CodedTile& coded)
      : coding_(coding),
        header_(coding.header),
        rect_(rect),
        coded_(coded),
        n_lights_(count(header_.dims.n_lights)),
        n_pixels_(count(rect.n_pixels())),
        first_(count(channel) * n_lights_),
        channel_(count(channel)),
        indices_(positions_of(header_)),
        plate_(coding, rect, channel, known),
        rows_(kRowsAtOnce * n_lights_),
        quanta_(n_lights_),
        nonzero_(n_lights_ + kSpareIndices),
        whole_errors_(indices_, n_pixels_),
        term_products_(coding.has_term_products ? header_.dims.n_lights : 0) {
    pixels_.shift.resize(n_pixels_);
    pixels_.gain.resize(n_pixels_);
    pixels_.plate = plate_.plate();
  }

  /// @throws Error  a value that is not finite
  PackedTile code(std::span<const float> values) {
    for (std::size_t p = 0; p < n_pixels_; p += kRowsAtOnce) {
      const std::size_t n = std::min(kRowsAtOnce, n_pixels_ - p);
      if (!code_rows(p, values.subspan(p * n_lights_, n * n_lights_))) {
        require_finite(coding_, rect_, values);
      }
    }
    return finish();
  }

 private:
  /// @return  whether all values are finite; if not, nothing is coded
  [[nodiscard]] bool code_rows(std::size_t first, std::span<const float> values) {
    const std::size_t n = values.size() / n_lights_;
    const std::span<Real> rows = std::span(rows_).first(n * n_lights_);
    std::array<double, kRowsAtOnce> sums{};
    const std::span<double> each = std::span(sums).first(n);
    TileSums& sums_of_tile = coded_.sums;
    const float peak = add_squares(values, sums_of_tile.light_energy.data() + first_, each);
    if (!std::isfinite(peak)) {
      return false;
    }
    sums_of_tile.peak = std::max(sums_of_tile.peak, double{peak});
    for (std::size_t i = 0; i < n; ++i) {
      subtract_plate_of(first + i, values.subspan(i * n_lights_, n_lights_),
                        rows.data() + i * n_lights_);
    }
    coding_.basis->forward(rows);
    std::array<double, kRowsAtOnce> norms{};
    std::transform(each.begin(), each.end(), norms.begin(), [this](double energy) {
      return std::max(std::sqrt(energy), header_.dark_norm);
    });
    for (std::size_t i = 0; i < n; ++i) {
      quantise_pixel(first + i, norms[i], rows.subspan(i * n_lights_, n_lights_));
    }
    sum_squares(std::span<const Real>(rows), each);
    for (std::size_t i = 0; i < n; ++i) {
      if (norms[i] > 0.0) {
        sums_of_tile.worst_pixel =
            std::max(sums_of_tile.worst_pixel, std::sqrt(each[i]) / norms[i]);
      }
      whole_errors_.append(std::span<const Real>(rows.subspan(i * n_lights_, n_lights_)),
                           1.0 / scale_);
    }
    // The transform is linear: the coefficients' errors become the lights'.
    coding_.basis->inverse(rows);
    const Real worst =
        add_squares(std::span<const Real>(rows), n, sums_of_tile.light_error.data() + first_);
    sums_of_tile.worst_value = std::max(sums_of_tile.worst_value, double{worst});
    return true;
  }

  void subtract_plate_of(std::size_t p, std::span<const float> t, Real* row) {
    const double gain = plate_.fit_gain(p, t);
    const double quantum = gain == 0.0 ? 0.0
                                       : std::clamp(std::round(gain / header_.gain_step),
                                                    -kLargestQuantum, kLargestQuantum);
    pixels_.gain[p] = static_cast<std::int32_t>(quantum);
    plate_.subtract(t, header_.gain_step * quantum, row);
  }

  /// The row becomes what rounding adds to it.
  void quantise_pixel(std::size_t p, double norm, std::span<Real> row) {
    double step = header_.step;
    if (std::isfinite(coding_.worst_pixel)) {
      const double bound = coding_.worst_pixel * norm;
      int shift = 0;
      while (quantisation_error<Real>(row, step) > bound * bound && shift < kMaxShift) {
        ++shift;
        step = std::ldexp(header_.step, -shift);
      }
      pixels_.shift[p] = static_cast<std::uint8_t>(shift);
    }
    quantise_row(step, row, quanta_.data(), coded_.sums.coefficient_energy.data() + first_,
                 coded_.sums.coefficient_error.data() + first_);
    const std::size_t n_before = kept_.size();
    const std::size_t n = find_nonzero(quanta_, nonzero_.data());
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t k = nonzero_[i];
      kept_.push_back(
          {static_cast<std::uint32_t>(indices_[k]), static_cast<std::uint32_t>(p), quanta_[k]});
    }
    if (coding_.has_term_products) {
      add_terms(std::span(kept_).last(kept_.size() - n_before), step / term_unit(header_),
                term_products_);
    }
  }

  PackedTile finish() {
    TileSums& sums = coded_.sums;
    sums.n_coefficients += static_cast<double>(kept_.size());
    std::vector<std::int32_t> products = whole_errors_.products();
    if (coded_.error_products.empty()) {
      coded_.error_products = std::move(products);
    } else {
      coded_.error_products.insert(coded_.error_products.end(), products.begin(),
                                   products.end());
    }
    coded_.term_products.insert(coded_.term_products.end(), term_products_.products().begin(),
                                term_products_.products().end());
    sums.gram_rests[channel_] = scale_ * whole_errors_.largest_rest();
    PackedTile packed;
    packed.pixels.bytes = encode_pixels(pixels_);
    packed.groups = pack_groups(kept_, coding_, n_pixels_);
    return packed;
  }

  const TileCoding& coding_;
  const BasisHeader& header_;
  TileRect rect_;
  CodedTile& coded_;
  std::size_t n_lights_;
  std::size_t n_pixels_;
  std::size_t first_;  ///< of the channel's sums
  std::size_t channel_;
  std::vector<int> indices_;
  PixelPlate<Real> plate_;
  PixelBlock pixels_;
  std::vector<Real> rows_;  ///< (kRowsAtOnce, n_lights)
  std::vector<std::int32_t> quanta_;
  std::vector<std::uint32_t> nonzero_;
  std::vector<Kept> kept_;
  TileErrors whole_errors_;
  SparseProducts term_products_;
  double scale_ = gram_scale(header_);
};

/// Lossless: the floats light by light; the coefficients' norms are kept for the fast mode.
PackedTile copy_channel(const TileCoding& coding, const TileRect& rect, int channel,
                        std::span<const float> values, TileSums& sums) {
  const BasisHeader& header = coding.header;
  const std::size_t n_lights = count(header.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  double* light_energy = sums.light_energy.data() + count(channel) * n_lights;
  double* energies = sums.coefficient_energy.data() + count(channel) * n_lights;
  std::vector<double> row(n_lights);
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<const float> t = values.subspan(p * n_lights, n_lights);
    sums.peak = std::max(sums.peak, double{add_squares(t, 1, light_energy)});
    std::copy(t.begin(), t.end(), row.begin());
    coding.basis->forward(std::span(row));
    for (std::size_t k = 0; k < n_lights; ++k) {
      energies[k] += row[k] * row[k];
    }
  }
  PackedTile packed;
  std::vector<float> rows;
  int begin = 0;
  for (const int end : header.group_ends) {
    rows.resize(count(end - begin) * n_pixels);
    for (int k = begin; k < end; ++k) {
      for (std::size_t p = 0; p < n_pixels; ++p) {
        rows[count(k - begin) * n_pixels + p] = values[p * n_lights + count(k)];
      }
    }
    packed.groups.push_back({encode_floats(rows, n_pixels), 0});
    begin = end;
  }
  sums.n_coefficients += static_cast<double>(n_pixels * n_lights);
  return packed;
}

/// Whole multiples of each light's unit: plate subtracted in whole units, S-transform, packed
/// losslessly.
PackedTile code_integers(const TileCoding& coding, const TileRect& rect, int channel,
                         std::span<const float> values, TileSums& sums) {
  const BasisHeader& header = coding.header;
  const std::size_t n_lights = count(header.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  PixelPlate<double> plate(coding, rect, channel, nullptr);
  PixelBlock pixels;
  pixels.shift.resize(n_pixels);
  pixels.gain.resize(n_pixels);
  pixels.plate = plate.plate();
  IntegerPrediction prediction(header, coding.vectors.vectors, rect, pixels.plate);
  std::vector<std::int64_t> rest(n_lights);
  std::vector<double> decoded(n_lights);
  std::vector<double> error(n_lights);
  std::vector<std::int32_t> stored(n_lights * n_pixels);  // (lights, pixels)
  const std::size_t first = count(channel) * n_lights;
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<const float> t = values.subspan(p * n_lights, n_lights);
    sums.peak =
        std::max(sums.peak, double{add_squares(t, 1, sums.light_energy.data() + first)});
    if (coding.vectors.rank > 0) {
      pixels.gain[p] = static_cast<std::int32_t>(
          std::clamp(std::round(plate.fit_gain(p, t) / header.gain_step), -kLargestQuantum,
                     kLargestQuantum));
    }
    const std::span<const std::int32_t> predicted = prediction.of(p, pixels.gain[p]);
    double energy = 0.0;
    double error_energy = 0.0;
    for (std::size_t k = 0; k < n_lights; ++k) {
      const double whole = std::round(double{t[k]} / header.units[k]);
      if (!(std::abs(whole) <= kLargestInteger)) {
        throw Error(fmt::format("light {} at pixel ({}, {}) is {:g} units, more than 2^24", k,
                                rect.x0 + static_cast<int>(p % count(rect.width)),
                                rect.y0 + static_cast<int>(p / count(rect.width)), whole),
                    coding.source, "compress with --max-error 0, which keeps every float");
      }
      rest[k] = static_cast<std::int64_t>(whole) - predicted[k];
      decoded[k] = double{static_cast<float>(whole * header.units[k])};
      error[k] = decoded[k] - double{t[k]};
      energy += double{t[k]} * double{t[k]};
      error_energy += error[k] * error[k];
      sums.light_error[first + k] += error[k] * error[k];
      sums.worst_value = std::max(sums.worst_value, std::abs(error[k]));
    }
    if (energy > 0.0) {
      sums.worst_pixel = std::max(sums.worst_pixel, std::sqrt(error_energy / energy));
    }
    coding.basis->forward_integers(rest);
    for (std::size_t k = 0; k < n_lights; ++k) {
      stored[k * n_pixels + p] = static_cast<std::int32_t>(rest[k]);
    }
    coding.basis->forward(std::span(decoded));
    coding.basis->forward(std::span(error));
    for (std::size_t k = 0; k < n_lights; ++k) {
      sums.coefficient_energy[first + k] += decoded[k] * decoded[k];
      sums.coefficient_error[first + k] += error[k] * error[k];
    }
  }
  PackedTile packed;
  packed.pixels.bytes = encode_pixels(pixels);
  int begin = 0;
  for (const int end : header.group_ends) {
    packed.groups.push_back(
        {encode_integers(
             std::span(stored).subspan(count(begin) * n_pixels, count(end - begin) * n_pixels),
             n_pixels),
         0});
    begin = end;
  }
  sums.n_coefficients += static_cast<double>(n_pixels * n_lights);
  return packed;
}

bool is_float_enough(const BasisHeader& header) {
  return header.requested_relative_l2 >= kFloatIsEnough &&
         header.requested_worst_pixel >= kFloatIsEnough;
}

/// Below 1e-34 a step's fractions have no reciprocal in floats.
bool is_coded_in_floats(const BasisHeader& header) {
  return is_float_enough(header) && std::isnormal(static_cast<float>(gram_scale(header)));
}

template <class Real>
StackSample sample_rows(const TileCoding& coding, const TileRect& rect,
                        std::span<const float> values) {
  const BasisHeader& header = coding.header;
  const std::size_t n_lights = count(header.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  StackSample sample;
  TilePlateFit& fit = sample.fit;
  std::vector<Real> rows(kRowsAtOnce * n_lights);
  std::vector<double> energies(n_lights);
  for (int c = 0; c < header.dims.channels; ++c) {
    PixelPlate<Real> plate(coding, rect, c, nullptr);
    fit.plates.insert(fit.plates.end(), plate.plate().begin(), plate.plate().end());
    const std::span<const float> channel =
        values.subspan(count(c) * n_pixels * n_lights, n_pixels * n_lights);
    for (std::size_t first = 0; first < n_pixels; first += kRowsAtOnce) {
      const std::size_t n = std::min(kRowsAtOnce, n_pixels - first);
      const float peak =
          add_squares(channel.subspan(first * n_lights, n * n_lights), n, energies.data());
      if (!std::isfinite(peak)) {
        require_finite(coding, rect, channel);
      }
      sample.peak = std::max(sample.peak, double{peak});
      for (std::size_t i = 0; i < n; ++i) {
        const std::span<const float> t = channel.subspan((first + i) * n_lights, n_lights);
        fit.gains.push_back(plate.fit_gain(first + i, t));
        plate.subtract(t, fit.gains.back(), rows.data() + i * n_lights);
      }
      coding.basis->forward(std::span(rows).first(n * n_lights));
      for (std::size_t i = 0; i < n * n_lights; ++i) {
        sample.residuals.add(double{rows[i]});
      }
    }
  }
  for (const double e : energies) {
    sample.energy += e;
  }
  sample.n_rows = double(header.dims.channels) * static_cast<double>(n_pixels);
  fit.is_in_floats = std::is_same_v<Real, float>;
  return sample;
}

void add(std::vector<double>& sum, const std::vector<double>& part) {
  std::transform(sum.begin(), sum.end(), part.begin(), sum.begin(), std::plus<>());
}

/// Counts the values that are lower bounds, and sums their energy.
void add_clipped(std::span<const float> values, std::span<const std::uint8_t> clipped,
                 std::size_t n_lights, double* counts, double* energies) {
  for (std::size_t from = 0; from < clipped.size(); from += n_lights) {
    const std::span<const std::uint8_t> row = clipped.subspan(from, n_lights);
    if (std::memchr(row.data(), 1, row.size()) == nullptr) {
      continue;
    }
    for (std::size_t k = 0; k < n_lights; ++k) {
      const double mark = row[k];
      const double value = values[from + k];
      counts[k] += mark;
      energies[k] += mark * value * value;
    }
  }
}

}  // namespace

TileSums::TileSums(const StackDims& dims) {
  const std::size_t n = count(dims.channels) * count(dims.n_lights);
  for (auto* part : {&light_energy, &light_error, &coefficient_energy, &coefficient_error,
                     &clipped, &clipped_energy}) {
    part->assign(n, 0.0);
  }
  gram_rests.assign(count(dims.channels), 0.0);
}

void TileSums::add(const TileSums& other) {
  relight::add(light_energy, other.light_energy);
  relight::add(light_error, other.light_error);
  relight::add(coefficient_energy, other.coefficient_energy);
  relight::add(coefficient_error, other.coefficient_error);
  relight::add(clipped, other.clipped);
  relight::add(clipped_energy, other.clipped_energy);
  std::transform(gram_rests.begin(), gram_rests.end(), other.gram_rests.begin(),
                 gram_rests.begin(), [](double a, double b) { return std::max(a, b); });
  peak = std::max(peak, other.peak);
  worst_pixel = std::max(worst_pixel, other.worst_pixel);
  worst_value = std::max(worst_value, other.worst_value);
  n_coefficients += other.n_coefficients;
}

std::vector<double> TileSums::to_numbers() const {
  std::vector<double> numbers = {peak, worst_pixel, worst_value, n_coefficients};
  for (const auto* part : {&light_energy, &light_error, &coefficient_energy, &coefficient_error,
                           &clipped, &clipped_energy, &gram_rests}) {
    numbers.insert(numbers.end(), part->begin(), part->end());
  }
  return numbers;
}

bool TileSums::set_numbers(std::span<const double> numbers) {
  if (numbers.size() != to_numbers().size()) {
    return false;
  }
  peak = numbers[0];
  worst_pixel = numbers[1];
  worst_value = numbers[2];
  n_coefficients = numbers[3];
  auto from = numbers.begin() + 4;
  for (auto* part : {&light_energy, &light_error, &coefficient_energy, &coefficient_error,
                     &clipped, &clipped_energy, &gram_rests}) {
    std::copy_n(from, part->size(), part->begin());
    from += static_cast<std::ptrdiff_t>(part->size());
  }
  return true;
}

double gram_scale(const BasisHeader& header) {
  // In floats an error may slightly exceed the dead zone.
  return 1.001 * header.dead_zone * header.step / kGramLargest;
}

double term_unit(const BasisHeader& header) { return std::exp2(std::ilogb(header.step)); }

CodedTile code_tile(const TileCoding& coding, const TileRect& rect,
                    std::span<const float> values, std::span<const std::uint8_t> clipped,
                    const TilePlateFit* known) {
  const BasisHeader& header = coding.header;
  const std::size_t per_channel = count(rect.n_pixels()) * count(header.dims.n_lights);
  HAARLIGHT_EXPECTS(values.size() == count(header.dims.channels) * per_channel,
                    "a tile's values");
  HAARLIGHT_EXPECTS(clipped.empty() || clipped.size() == values.size(), "one mark per value");
  if (header.coding != BasisCoding::quantised) {
    require_finite(coding, rect, values);
  }
  CodedTile coded;
  coded.sums = TileSums(header.dims);
  const std::size_t n_lights = count(header.dims.n_lights);
  for (std::size_t c = 0; !clipped.empty() && c < count(header.dims.channels); ++c) {
    add_clipped(values.subspan(c * per_channel, per_channel),
                clipped.subspan(c * per_channel, per_channel), n_lights,
                coded.sums.clipped.data() + c * n_lights,
                coded.sums.clipped_energy.data() + c * n_lights);
  }
  for (int c = 0; c < header.dims.channels; ++c) {
    const std::span<const float> t = values.subspan(count(c) * per_channel, per_channel);
    if (header.coding == BasisCoding::lossless) {
      coded.channels.push_back(copy_channel(coding, rect, c, t, coded.sums));
    } else if (header.coding == BasisCoding::integers) {
      coded.channels.push_back(code_integers(coding, rect, c, t, coded.sums));
    } else if (is_coded_in_floats(header)) {
      coded.channels.push_back(ChannelCoder<float>(coding, rect, c, known, coded).code(t));
    } else {
      coded.channels.push_back(ChannelCoder<double>(coding, rect, c, known, coded).code(t));
    }
  }
  return coded;
}

void StackSample::merge(const StackSample& other) {
  energy += other.energy;
  peak = std::max(peak, other.peak);
  n_rows += other.n_rows;
  residuals.merge(other.residuals);
}

StackSample sample_pixels(const TileCoding& coding, const TileRect& rect,
                          std::span<const float> values) {
  return is_float_enough(coding.header) ? sample_rows<float>(coding, rect, values)
                                        : sample_rows<double>(coding, rect, values);
}

}  // namespace haarlight::relight
