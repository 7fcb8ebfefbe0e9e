#include "relight/basis/compress.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <optional>

#include <fmt/format.h>

#include "core/error.h"
#include "core/parallel.h"
#include "relight/basis/haar.h"
#include "relight/basis/plate.h"

namespace haarlight {

namespace {

// Measured on the twin's airplane and tree: 0.5 and 0.75 give 1 to 5 % larger files, 1.0 3 to 7
// % (docs/numerics/relight.md).
constexpr double kDeadZone = 0.6;
constexpr double kDarkFloor = 0.01;  // pixels below 1 % of the rms norm are judged against that
constexpr double kPlateShare = 0.25;  // plate vectors: rms they miss, as a share of the target
constexpr double kPlateStep = 0.125;  // plate step, as a share of the allowed rms error a pixel
constexpr double kStepMargin = 0.998;  // the histogram predicts the error to about 0.1 %
constexpr int kMaxAttempts = 6;
constexpr int kMaxShift = 40;
constexpr double kLargestValue = 0x1p30;
constexpr int kTile = 32;
constexpr std::size_t kMaxBatch = 64;

std::size_t count(int n) { return static_cast<std::size_t>(n); }

float round_up(double v) {
  const auto f = static_cast<float>(v);
  return double{f} < v ? std::nextafter(f, std::numeric_limits<float>::infinity()) : f;
}

std::vector<float> root_round_up(const std::vector<double>& squares) {
  std::vector<float> roots(squares.size());
  std::transform(squares.begin(), squares.end(), roots.begin(),
                 [](double s) { return round_up(std::sqrt(s)); });
  return roots;
}

void add(std::vector<double>& sum, const std::vector<double>& part) {
  std::transform(sum.begin(), sum.end(), part.begin(), sum.begin(), std::plus<>());
}

/// Magnitudes by the first bits of their float: 64 bins an octave, each with its exact energy.
class MagnitudeHistogram {
 public:
  MagnitudeHistogram() : count_(kBins), energy_(kBins) {}

  void add(double c) {
    const auto bits = std::bit_cast<std::uint32_t>(static_cast<float>(std::abs(c)));
    const std::size_t bin = std::min<std::size_t>(bits >> kDroppedBits, kBins - 1);
    count_[bin] += 1.0;
    energy_[bin] += c * c;
  }

  void merge(const MagnitudeHistogram& other) {
    haarlight::add(count_, other.count_);
    haarlight::add(energy_, other.energy_);
  }

  /// Energy of the error that a quantiser with this step leaves.
  [[nodiscard]] double error_energy(double step) const {
    constexpr double kFine = 16.0;  // from here on the error is uniform: step^2 / 12
    double error = 0.0;
    for (std::size_t i = 0; i < kBins; ++i) {
      if (count_[i] == 0.0) {
        continue;
      }
      const double v = std::sqrt(energy_[i] / count_[i]) / step;
      if (v < kDeadZone) {
        error += energy_[i];
      } else if (v < kFine) {
        const double rest = (v - std::round(v)) * step;
        error += count_[i] * rest * rest;
      } else {
        error += count_[i] * step * step / 12.0;
      }
    }
    return error;
  }

  /// The largest step whose error energy stays at or below `allowed`.
  [[nodiscard]] double choose_step(double allowed, double largest) const {
    double low = largest * 0x1p-48;
    double high = largest * 4.0;
    if (error_energy(high) <= allowed) {
      return high;
    }
    for (int i = 0; i < 60; ++i) {
      const double middle = std::sqrt(low * high);
      (error_energy(middle) <= allowed ? low : high) = middle;
    }
    return low;
  }

 private:
  static constexpr unsigned kDroppedBits = 17;
  static constexpr std::size_t kBins = std::size_t{1} << (31 - kDroppedBits);
  std::vector<double> count_;
  std::vector<double> energy_;
};

struct Norms {
  std::vector<double> light_energy;  ///< (channels, n_lights)
  double peak = 0.0;
};

struct Coded {
  std::vector<PackedTile> channels;
  std::vector<double> coefficient_energy;  ///< (channels, n_lights) each
  std::vector<double> coefficient_error;
  std::vector<double> light_error;
  double worst_pixel = 0.0;
  double worst_value = 0.0;
  double n_coefficients = 0.0;
};

/// One coefficient that was kept.
struct Kept {
  std::uint32_t place;
  std::uint32_t pixel;
  std::int32_t value;
};

class Compressor {
 public:
  Compressor(const CompressSource& source, const CompressOptions& options);
  CompressSummary run(const std::filesystem::path& file);

 private:
  [[nodiscard]] TileRect tile_rect(std::size_t i_tile) const;
  template <class R>
  void for_each_tile(const std::string& label, const std::function<R(std::size_t)>& work,
                     const std::function<void(R&)>& take);
  [[nodiscard]] std::vector<float> read_stack(const TileRect& rect) const;
  [[noreturn]] void throw_not_finite(const TileRect& rect, std::size_t i_value) const;

  void measure();
  [[nodiscard]] Norms measure_tile(std::size_t i_tile);
  void fit_plate();
  void share_memory();
  [[nodiscard]] std::vector<float> fit_weights(const TileRect& rect, int channel,
                                               std::span<const float> t,
                                               std::span<const float> plate) const;
  [[nodiscard]] MagnitudeHistogram histogram_tile(std::size_t i_tile);
  void residual(std::span<const float> t, std::span<const double> plate_values,
                std::span<double> out) const;
  void transform(std::span<double> values) const;
  [[nodiscard]] std::vector<float> read_plate(const TileRect& rect) const;
  [[nodiscard]] std::vector<std::int32_t> quantised_plate(const TileRect& rect, int channel,
                                                          std::span<const float> t);
  [[nodiscard]] float* kept_weights(const TileRect& rect, int channel, std::size_t p);

  [[nodiscard]] Coded code_tile(std::size_t i_tile);
  void code_channel(const TileRect& rect, int channel, std::span<const float> t, Coded& coded);
  [[nodiscard]] Coded copy_tile(std::size_t i_tile);
  [[nodiscard]] CompressSummary write(const std::filesystem::path& file);
  void set_lossless();

  const CompressSource& source_;
  const CompressOptions& options_;
  BasisHeader header_;
  BasisTables tables_;
  int tiles_x_ = 0;
  std::size_t n_tiles_ = 0;
  std::size_t batch_ = 1;
  std::vector<int> order_;
  std::vector<int> place_of_;         ///< inverse of order_
  std::vector<float> plate_weights_;  ///< (channels, pixels, rank): g U; empty where it would
                                      ///< not fit: then each pass fits them again
  std::vector<double> light_energy_;
  double largest_ = 0.0;  ///< no coefficient is larger
  std::uint64_t bytes_moved_ = 0;
};

Compressor::Compressor(const CompressSource& source, const CompressOptions& options)
    : source_(source), options_(options) {
  HAARLIGHT_EXPECTS(source.stack != nullptr, "a stack to compress");
  HAARLIGHT_EXPECTS(options.relative_l2 >= 0.0 && options.worst_pixel >= 0.0,
                    "errors asked for are not negative");
  header_.dims = source.stack->dims();
  header_.tile = kTile;
  header_.basis = options.basis;
  header_.grid = source.grid;
  header_.dead_zone = kDeadZone;
  header_.dark_floor = kDarkFloor;
  header_.rig_toml = source.rig_toml;
  header_.rig_hash = source.rig_hash;
  header_.lights = source.lights;
  header_.asked_relative_l2 = options.relative_l2;
  header_.asked_worst_pixel = options.worst_pixel;
  header_.source = source.name;
  header_.source_hash = source.hash;
  header_.kind = source.kind;
  header_.program = "haarlight " HAARLIGHT_VERSION;
  if (options.basis == BasisKind::haar &&
      (source.grid <= 0 || !is_haar_size(source.grid) ||
       header_.dims.n_lights % (source.grid * source.grid) != 0)) {
    throw Error(
        "the Haar basis needs lights in square grids of 2, 4, 8, ... a side; these do not "
        "form one",
        source.name, "use --basis direct, which takes any lights");
  }
  if (options.relative_l2 == 0.0 || options.worst_pixel == 0.0) {
    header_.coding = BasisCoding::lossless;
  }
  const StackDims& dims = header_.dims;
  if (source.plate != nullptr) {
    const StackDims plate = source.plate->dims();
    if (plate.width != dims.width || plate.height != dims.height ||
        plate.n_lights != dims.n_lights ||
        (plate.channels != 1 && plate.channels != dims.channels)) {
      throw Error(
          fmt::format("the plate is {} x {} pixels, {} channels, {} lights; the capture is "
                      "{} x {}, {}, {}",
                      plate.width, plate.height, plate.channels, plate.n_lights, dims.width,
                      dims.height, dims.channels, dims.n_lights),
          source.plate_source, "give the plate of this rig, or --plate none");
    }
  }
  tiles_x_ = (dims.width + kTile - 1) / kTile;
  n_tiles_ = count(tiles_x_) * count((dims.height + kTile - 1) / kTile);
  share_memory();
}

/// How many tiles are in work at a time, and whether the plate's weights are kept meanwhile.
void Compressor::share_memory() {
  const StackDims& dims = header_.dims;
  // A tile in work: its values, the plate's, kept coefficients at 12 bytes each and their
  // packed copies.
  const std::uint64_t tile_values = std::uint64_t{kTile} * kTile * count(dims.n_lights);
  const std::uint64_t tile_bytes =
      tile_values * (4 * count(dims.channels) +
                     (source_.plate != nullptr ? 4 * count(dims.channels) : 0) + 32);
  const std::uint64_t budget = options_.memory_bytes;
  if (tile_bytes > budget) {
    throw Error(
        fmt::format("one tile needs {} bytes of memory, the budget is {}", tile_bytes, budget),
        source_.name, "give a larger --memory");
  }
  const std::size_t n_weights =
      count(dims.channels) * dims.n_pixels() * count(header_.plate_rank);
  const std::uint64_t weight_bytes = n_weights * sizeof(float);
  const bool fits = weight_bytes <= budget / 4 && weight_bytes <= budget - tile_bytes;
  plate_weights_.assign(fits ? n_weights : 0, 0.0F);
  batch_ =
      std::clamp<std::size_t>((budget - (fits ? weight_bytes : 0)) / tile_bytes, 1, kMaxBatch);
}

TileRect Compressor::tile_rect(std::size_t i_tile) const {
  const int t = static_cast<int>(i_tile);
  const int x0 = t % tiles_x_ * kTile;
  const int y0 = t / tiles_x_ * kTile;
  return {x0, y0, std::min(kTile, header_.dims.width - x0),
          std::min(kTile, header_.dims.height - y0)};
}

/// Works on a batch of tiles in parallel, takes the results one by one in order.
template <class R>
void Compressor::for_each_tile(const std::string& label,
                               const std::function<R(std::size_t)>& work,
                               const std::function<void(R&)>& take) {
  Progress progress(label, n_tiles_, options_.progress);
  std::vector<std::optional<R>> results(batch_);
  for (std::size_t begin = 0; begin < n_tiles_; begin += batch_) {
    const std::size_t size = std::min(batch_, n_tiles_ - begin);
    parallel_for(size, 1, [&](std::size_t from, std::size_t to) {
      for (std::size_t i = from; i < to; ++i) {
        results[i] = work(begin + i);
        progress.advance();
      }
    });
    for (std::size_t i = 0; i < size; ++i) {
      take(*results[i]);
      results[i].reset();
    }
  }
  bytes_moved_ += header_.dims.n_pixels() * count(header_.dims.channels) *
                  count(header_.dims.n_lights) * sizeof(float);
}

std::vector<float> Compressor::read_stack(const TileRect& rect) const {
  std::vector<float> values(count(header_.dims.channels) * count(rect.n_pixels()) *
                            count(header_.dims.n_lights));
  source_.stack->read_tile(rect, values);
  return values;
}

void Compressor::throw_not_finite(const TileRect& rect, std::size_t i_value) const {
  const std::size_t light = i_value % count(header_.dims.n_lights);
  const std::size_t pixel = i_value / count(header_.dims.n_lights) % count(rect.n_pixels());
  throw Error(fmt::format("the stack is not finite under light {} at pixel ({}, {})", light,
                          rect.x0 + static_cast<int>(pixel % count(rect.width)),
                          rect.y0 + static_cast<int>(pixel / count(rect.width))),
              source_.name,
              "shoot that light again; one such value would spread to every light's picture");
}

void Compressor::measure() {
  const StackDims& dims = header_.dims;
  light_energy_.assign(count(dims.channels) * count(dims.n_lights), 0.0);
  for_each_tile<Norms>(
      "measure", [this](std::size_t t) { return measure_tile(t); },
      [this](Norms& norms) {
        add(light_energy_, norms.light_energy);
        header_.peak = std::max(header_.peak, norms.peak);
      });
  double energy = 0.0;
  for (const double e : light_energy_) {
    energy += e;
  }
  header_.stack_norm = std::sqrt(energy);
  // |<basis vector, T_p>| <= ||T_p||_1 / 1 and <= peak * sqrt(n_lights).
  largest_ = header_.peak * std::sqrt(double(dims.n_lights));
}

Norms Compressor::measure_tile(std::size_t i_tile) {
  const TileRect rect = tile_rect(i_tile);
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::vector<float> t = read_stack(rect);
  Norms norms;
  norms.light_energy.assign(light_energy_.size(), 0.0);
  const std::size_t n_pixels = count(rect.n_pixels());
  for (std::size_t i = 0; i < t.size(); ++i) {
    if (!std::isfinite(t[i])) {
      throw_not_finite(rect, i);
    }
    const double v = t[i];
    norms.light_energy[i / (n_pixels * n_lights) * n_lights + i % n_lights] += v * v;
    norms.peak = std::max(norms.peak, std::abs(v));
  }
  if (header_.plate_rank == 0) {
    return norms;
  }
  if (plate_weights_.empty()) {
    return norms;
  }
  const std::vector<float> plate = read_plate(rect);
  const std::size_t rank = count(header_.plate_rank);
  for (int c = 0; c < header_.dims.channels; ++c) {
    const std::vector<float> weights = fit_weights(
        rect, c, std::span(t).subspan(count(c) * n_pixels * n_lights, n_pixels * n_lights),
        plate);
    for (std::size_t p = 0; p < n_pixels; ++p) {
      std::copy_n(weights.data() + p * rank, rank, kept_weights(rect, c, p));
    }
  }
  return norms;
}

std::vector<float> Compressor::read_plate(const TileRect& rect) const {
  std::vector<float> plate(count(source_.plate->dims().channels) * count(rect.n_pixels()) *
                           count(header_.dims.n_lights));
  source_.plate->read_tile(rect, plate);
  return plate;
}

/// g U of a tile's pixels, (pixels, rank). @param t  one channel of the tile
std::vector<float> Compressor::fit_weights(const TileRect& rect, int channel,
                                           std::span<const float> t,
                                           std::span<const float> plate) const {
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  const std::size_t rank = count(header_.plate_rank);
  const std::size_t plate_channel = source_.plate->dims().channels == 1 ? 0 : count(channel);
  std::vector<float> weights(n_pixels * rank);
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<const float> row = t.subspan(p * n_lights, n_lights);
    const std::span<const float> b =
        plate.subspan((plate_channel * n_pixels + p) * n_lights, n_lights);
    const double gain = source_.kind == "plate" ? 1.0 : plate_gain(row, b);
    if (gain == 0.0) {
      continue;
    }
    for (std::size_t j = 0; j < rank; ++j) {
      const float* vector = tables_.plate_vectors.data() + j * n_lights;
      double product = 0.0;
      for (std::size_t k = 0; k < n_lights; ++k) {
        product += double{vector[k]} * double{b[k]};
      }
      weights[p * rank + j] = static_cast<float>(gain * product);
    }
  }
  return weights;
}

float* Compressor::kept_weights(const TileRect& rect, int channel, std::size_t p) {
  const std::size_t x = count(rect.x0) + p % count(rect.width);
  const std::size_t y = count(rect.y0) + p / count(rect.width);
  return plate_weights_.data() +
         (count(channel) * header_.dims.n_pixels() + y * count(header_.dims.width) + x) *
             count(header_.plate_rank);
}

void Compressor::fit_plate() {
  if (source_.plate == nullptr || header_.coding == BasisCoding::lossless) {
    return;
  }
  PlateVectors plate =
      fit_plate_vectors(*source_.plate, kPlateShare * header_.asked_relative_l2);
  if (plate.rank == 0) {
    return;  // the plate is black: nothing to take off
  }
  header_.plate = source_.plate_kind;
  header_.plate_source = source_.plate_source;
  header_.plate_rank = plate.rank;
  tables_.plate_vectors = std::move(plate.vectors);
}

void Compressor::transform(std::span<double> values) const {
  if (header_.basis == BasisKind::haar) {
    const std::size_t per_grid = count(header_.grid) * count(header_.grid);
    for (std::size_t g = 0; g < values.size(); g += per_grid) {
      haar_forward(values.subspan(g, per_grid), header_.grid);
    }
  }
}

void Compressor::residual(std::span<const float> t, std::span<const double> plate_values,
                          std::span<double> out) const {
  std::copy(t.begin(), t.end(), out.begin());
  for (std::size_t j = 0; j < plate_values.size(); ++j) {
    const float* vector = tables_.plate_vectors.data() + j * out.size();
    for (std::size_t k = 0; k < out.size(); ++k) {
      out[k] -= plate_values[j] * double{vector[k]};
    }
  }
  transform(out);
}

/// Multiples of the plate step, (rank, pixels). @param t  one channel of the tile
std::vector<std::int32_t> Compressor::quantised_plate(const TileRect& rect, int channel,
                                                      std::span<const float> t) {
  const std::size_t rank = count(header_.plate_rank);
  const std::size_t n_pixels = count(rect.n_pixels());
  std::vector<std::int32_t> quantised(rank * n_pixels);
  if (rank == 0) {
    return quantised;
  }
  std::vector<float> fitted;
  if (plate_weights_.empty()) {
    fitted = fit_weights(rect, channel, t, read_plate(rect));
  }
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const float* weights =
        fitted.empty() ? kept_weights(rect, channel, p) : fitted.data() + p * rank;
    for (std::size_t j = 0; j < rank; ++j) {
      quantised[j * n_pixels + p] = static_cast<std::int32_t>(std::clamp(
          std::round(double{weights[j]} / header_.plate_step), -kLargestValue, kLargestValue));
    }
  }
  return quantised;
}

MagnitudeHistogram Compressor::histogram_tile(std::size_t i_tile) {
  const TileRect rect = tile_rect(i_tile);
  const std::vector<float> t = read_stack(rect);
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  std::vector<double> row(n_lights);
  std::vector<double> plate(count(header_.plate_rank));
  MagnitudeHistogram histogram;
  for (int c = 0; c < header_.dims.channels; ++c) {
    const std::vector<std::int32_t> quantised = quantised_plate(
        rect, c, std::span(t).subspan(count(c) * n_pixels * n_lights, n_pixels * n_lights));
    for (std::size_t p = 0; p < n_pixels; ++p) {
      for (std::size_t j = 0; j < plate.size(); ++j) {
        plate[j] = header_.plate_step * quantised[j * n_pixels + p];
      }
      residual({t.data() + (count(c) * n_pixels + p) * n_lights, n_lights}, plate, row);
      for (const double v : row) {
        histogram.add(v);
      }
    }
  }
  return histogram;
}

std::int32_t quantise(double c, double step) {
  const double v = c / step;
  return std::abs(v) < kDeadZone ? 0
                                 : static_cast<std::int32_t>(std::clamp(
                                       std::round(v), -kLargestValue, kLargestValue));
}

double quantisation_error(std::span<const double> coefficients, double step) {
  double error = 0.0;
  for (const double c : coefficients) {
    const double rest = c - step * quantise(c, step);
    error += rest * rest;
  }
  return error;
}

/// Sorts by place, keeping the pixels' order, and packs each group.
std::vector<PackedTile::Block> pack_groups(const std::vector<Kept>& kept,
                                           const BasisHeader& header, std::size_t n_pixels) {
  std::vector<std::size_t> start(count(header.dims.n_lights) + 1);
  for (const Kept& k : kept) {
    ++start[k.place + 1];
  }
  for (std::size_t i = 1; i < start.size(); ++i) {
    start[i] += start[i - 1];
  }
  std::vector<std::size_t> next = start;
  std::vector<std::uint32_t> pixels(kept.size());
  std::vector<std::int32_t> values(kept.size());
  for (const Kept& k : kept) {
    const std::size_t to = next[k.place]++;
    pixels[to] = k.pixel;
    values[to] = k.value;
  }
  std::vector<PackedTile::Block> groups;
  int begin = 0;
  for (const int end : header.group_ends) {
    SparseBlock block;
    for (int place = begin; place < end; ++place) {
      for (std::size_t e = start[count(place)]; e < start[count(place) + 1]; ++e) {
        block.cell.push_back(
            static_cast<std::uint32_t>(count(place - begin) * n_pixels + pixels[e]));
        block.value.push_back(values[e]);
      }
    }
    groups.push_back({encode_sparse(block), static_cast<std::uint32_t>(block.cell.size())});
    begin = end;
  }
  return groups;
}

void Compressor::code_channel(const TileRect& rect, int channel, std::span<const float> t,
                              Coded& coded) {
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  const double rms_pixel = header_.stack_norm / std::sqrt(double(header_.dims.channels) *
                                                          double(header_.dims.n_pixels()));
  PixelBlock pixels;
  pixels.shift.resize(n_pixels);
  pixels.plate = quantised_plate(rect, channel, t);
  std::vector<double> plate(count(header_.plate_rank));
  std::vector<double> row(n_lights);
  std::vector<double> decoded(n_lights);
  std::vector<Kept> kept;
  double* energies = coded.coefficient_energy.data() + count(channel) * n_lights;
  double* errors = coded.coefficient_error.data() + count(channel) * n_lights;
  double* light_errors = coded.light_error.data() + count(channel) * n_lights;
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<const float> truth = t.subspan(p * n_lights, n_lights);
    for (std::size_t j = 0; j < plate.size(); ++j) {
      plate[j] = header_.plate_step * pixels.plate[j * n_pixels + p];
    }
    residual(truth, plate, row);
    double energy = 0.0;
    for (const float v : truth) {
      energy += double{v} * double{v};
    }
    const double norm = std::max(std::sqrt(energy), header_.dark_floor * rms_pixel);
    const double bound = options_.worst_pixel * norm;
    int shift = 0;
    double error = quantisation_error(row, header_.step);
    while (error > bound * bound && shift < kMaxShift) {
      ++shift;
      error = quantisation_error(row, std::ldexp(header_.step, -shift));
    }
    pixels.shift[p] = static_cast<std::uint8_t>(shift);
    if (norm > 0.0) {
      coded.worst_pixel = std::max(coded.worst_pixel, std::sqrt(error) / norm);
    }
    const double step = std::ldexp(header_.step, -shift);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const std::int32_t v = quantise(row[k], step);
      if (v != 0) {
        kept.push_back(
            {static_cast<std::uint32_t>(place_of_[k]), static_cast<std::uint32_t>(p), v});
      }
      decoded[k] = step * v;
      energies[k] += decoded[k] * decoded[k];
      errors[k] += (decoded[k] - row[k]) * (decoded[k] - row[k]);
    }
    reconstruct_pixel(header_, tables_, plate, decoded);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const double rest = decoded[k] - double{truth[k]};
      light_errors[k] += rest * rest;
      coded.worst_value = std::max(coded.worst_value, std::abs(rest));
    }
  }
  coded.n_coefficients += static_cast<double>(kept.size());
  PackedTile packed;
  packed.pixels.bytes = encode_pixels(pixels);
  packed.groups = pack_groups(kept, header_, n_pixels);
  coded.channels.push_back(std::move(packed));
}

Coded Compressor::code_tile(std::size_t i_tile) {
  const TileRect rect = tile_rect(i_tile);
  const std::vector<float> t = read_stack(rect);
  const std::size_t per_channel = count(rect.n_pixels()) * count(header_.dims.n_lights);
  Coded coded;
  coded.coefficient_energy.assign(light_energy_.size(), 0.0);
  coded.coefficient_error.assign(light_energy_.size(), 0.0);
  coded.light_error.assign(light_energy_.size(), 0.0);
  for (int c = 0; c < header_.dims.channels; ++c) {
    code_channel(rect, c, std::span(t).subspan(count(c) * per_channel, per_channel), coded);
  }
  return coded;
}

/// Lossless: the floats light by light; the coefficients' norms are kept for the fast mode.
Coded Compressor::copy_tile(std::size_t i_tile) {
  const TileRect rect = tile_rect(i_tile);
  const std::vector<float> t = read_stack(rect);
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t n_pixels = count(rect.n_pixels());
  Coded coded;
  coded.coefficient_energy.assign(light_energy_.size(), 0.0);
  coded.coefficient_error.assign(light_energy_.size(), 0.0);
  coded.light_error.assign(light_energy_.size(), 0.0);
  std::vector<double> row(n_lights);
  std::vector<float> rows;
  for (int c = 0; c < header_.dims.channels; ++c) {
    const float* values = t.data() + count(c) * n_pixels * n_lights;
    for (std::size_t p = 0; p < n_pixels; ++p) {
      residual({values + p * n_lights, n_lights}, {}, row);
      for (std::size_t k = 0; k < n_lights; ++k) {
        coded.coefficient_energy[count(c) * n_lights + k] += row[k] * row[k];
      }
    }
    PackedTile packed;
    int begin = 0;
    for (const int end : header_.group_ends) {
      rows.resize(count(end - begin) * n_pixels);
      for (int k = begin; k < end; ++k) {
        for (std::size_t p = 0; p < n_pixels; ++p) {
          rows[count(k - begin) * n_pixels + p] = values[p * n_lights + count(k)];
        }
      }
      packed.groups.push_back({encode_floats(rows, n_pixels), 0});
      begin = end;
    }
    coded.channels.push_back(std::move(packed));
    coded.n_coefficients += static_cast<double>(n_pixels * n_lights);
  }
  return coded;
}

CompressSummary Compressor::write(const std::filesystem::path& file) {
  header_.group_ends = default_group_ends(header_);
  order_ = coefficient_order(header_);
  place_of_.assign(order_.size(), 0);
  for (std::size_t i = 0; i < order_.size(); ++i) {
    place_of_[count(order_[i])] = static_cast<int>(i);
  }
  const bool is_lossless = header_.coding == BasisCoding::lossless;
  BasisWriter writer(file);
  Coded sum;
  sum.coefficient_energy.assign(light_energy_.size(), 0.0);
  sum.coefficient_error = sum.coefficient_energy;
  sum.light_error = sum.coefficient_energy;
  for_each_tile<Coded>(
      is_lossless ? "code (exact)" : "code",
      [&](std::size_t t) { return is_lossless ? copy_tile(t) : code_tile(t); },
      [&](Coded& tile) {
        for (const PackedTile& channel : tile.channels) {
          writer.append(channel);
        }
        add(sum.coefficient_energy, tile.coefficient_energy);
        add(sum.coefficient_error, tile.coefficient_error);
        add(sum.light_error, tile.light_error);
        sum.worst_pixel = std::max(sum.worst_pixel, tile.worst_pixel);
        sum.worst_value = std::max(sum.worst_value, tile.worst_value);
        sum.n_coefficients += tile.n_coefficients;
      });
  double error = 0.0;
  for (const double e : sum.light_error) {
    error += e;
  }
  header_.reached.relative_l2 =
      header_.stack_norm > 0.0 ? std::sqrt(error) / header_.stack_norm : 0.0;
  header_.reached.worst_pixel = sum.worst_pixel;
  header_.reached.worst_value = header_.peak > 0.0 ? sum.worst_value / header_.peak : 0.0;
  header_.mean_coefficients =
      sum.n_coefficients / (double(header_.dims.channels) * double(header_.dims.n_pixels()));
  CompressSummary summary;
  summary.header = header_;
  if (!is_lossless && !summary.is_reached()) {
    return summary;  // the writer's file is dropped
  }
  tables_.coefficient_norms = root_round_up(sum.coefficient_energy);
  tables_.coefficient_errors = root_round_up(sum.coefficient_error);
  tables_.light_norms = root_round_up(light_energy_);
  tables_.light_errors = root_round_up(sum.light_error);
  for (std::size_t i = 0; i < light_energy_.size(); ++i) {
    if (light_energy_[i] > 0.0) {
      summary.worst_light =
          std::max(summary.worst_light, std::sqrt(sum.light_error[i] / light_energy_[i]));
    }
  }
  summary.bytes = writer.finish(header_, tables_);
  return summary;
}

void Compressor::set_lossless() {
  header_.coding = BasisCoding::lossless;
  header_.plate = "none";
  header_.plate_source.clear();
  header_.plate_rank = 0;
  header_.plate_step = 0.0;
  header_.step = 0.0;
  tables_.plate_vectors.clear();
  plate_weights_.clear();
}

CompressSummary Compressor::run(const std::filesystem::path& file) {
  fit_plate();
  share_memory();
  measure();
  const double allowed = header_.asked_relative_l2 * header_.stack_norm;
  if (header_.coding == BasisCoding::quantised) {
    header_.plate_step =
        header_.plate_rank == 0
            ? 0.0
            : kPlateStep * std::max(allowed, header_.stack_norm * 1e-9) /
                  std::sqrt(double(header_.dims.channels) * double(header_.dims.n_pixels()));
    if (header_.stack_norm == 0.0) {
      header_.step = 1.0;  // a black stack: nothing will be kept
      header_.plate_step = 1.0;
    } else {
      MagnitudeHistogram histogram;
      for_each_tile<MagnitudeHistogram>(
          "choose the step", [this](std::size_t t) { return histogram_tile(t); },
          [&](MagnitudeHistogram& tile) { histogram.merge(tile); });
      header_.step =
          histogram.choose_step(kStepMargin * kStepMargin * allowed * allowed, largest_);
    }
    for (int attempt = 0; attempt < kMaxAttempts; ++attempt) {
      CompressSummary summary = write(file);
      if (summary.is_reached()) {
        summary.bytes_moved = bytes_moved_;
        return summary;
      }
      const double excess = header_.reached.relative_l2 / header_.asked_relative_l2;
      header_.step *= std::min(0.99, kStepMargin / std::max(excess, 1e-3));
    }
    // Floats have 24 bits: an error below their rounding is reached by keeping them all.
    set_lossless();
  } else {
    set_lossless();
  }
  CompressSummary summary = write(file);
  summary.bytes_moved = bytes_moved_;
  return summary;
}

}  // namespace

CompressSummary compress_stack(const CompressSource& source, const std::filesystem::path& file,
                               const CompressOptions& options) {
  return Compressor(source, options).run(file);
}

}  // namespace haarlight
