// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/compress.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstring>
#include <functional>
#include <iterator>
#include <limits>
#include <mutex>
#include <numeric>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "core/parallel.h"
#include "haarlight/core/error.h"
#include "relight/basis/coder/tile_coder.h"
#include "relight/basis/compress_parameters.h"
#include "relight/basis/error_gram.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/picture_bound.h"
#include "relight/basis/plate/tile_plate.h"
#include "relight/basis/work_folder.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMethodVersion =
    "compress 5";                        // part of the pieces' key: bump when bytes change
constexpr double kIntegerPlate = 0.004;  // below the noise of any camera
// The histogram predicts the error to about 0.1 % where it has seen every row; from rows 32
// apart it predicts the rest to 1 %.
constexpr double kStepMargin = 0.997;
constexpr double kSampledMargin = 0.985;
constexpr std::size_t kSmallPicture = std::size_t{1} << 18U;  // pixels: all rows are sampled
constexpr int kMaxAttempts = 6;
// Products of a pixel's coefficients grow with the square of their number: above this, files
// keep the triangle inequality for dropped terms.
constexpr double kMostProductTerms = 32.0;
// Where more than this fraction of the coefficients is kept, most of them are noise: by a
// thorough search files with 8 % kept are up to 2.5 % smaller, with 16 % by 1 % or larger; with
// 19 % and more they are 1 to 3 % larger (docs/numerics/relight.md, "Dense files").
constexpr double kDenseFraction = 0.18;
constexpr std::size_t kMaxBatch = 32;

std::vector<float> root_round_up(const std::vector<double>& squares) {
  std::vector<float> roots(squares.size());
  std::transform(squares.begin(), squares.end(), roots.begin(),
                 [](double s) { return round_up(std::sqrt(s)); });
  return roots;
}

/// The lights can have the basis, and the basis the coding.
void require_basis(const CompressSource& source, const CompressOptions& options) {
  const KnownBasis& basis = known_basis(options.basis);
  const HaarGrid& grid = source.grid;
  const std::string missing =
      basis.need != GridNeed::none && grid.size() > 0 &&
              source.stack->dims().n_lights % grid.size() != 0
          ? fmt::format("{} lights are no grids of {} x {}", source.stack->dims().n_lights,
                        grid.rows, grid.cols)
          : missing_grid(basis.need, grid);
  if (!missing.empty()) {
    throw Error(
        fmt::format("--basis {} needs {}: {}", basis.word, grid_words(basis.need), missing),
        source.location, "use --basis direct, which takes any lights");
  }
  if (options.is_integer && !is_integer_basis(options.basis)) {
    throw Error(fmt::format("--basis {} has no form for whole numbers", basis.word),
                source.location,
                "use --basis haar or direct with --whole-steps, or --max-error with this basis",
                ExitCode::usage);
  }
}

}  // namespace

BasisHeader first_header(const CompressSource& source, const CompressOptions& options) {
  HAARLIGHT_EXPECTS(source.stack != nullptr, "a stack to compress");
  HAARLIGHT_EXPECTS(options.relative_l2 >= 0.0 && options.worst_pixel >= 0.0,
                    "requested errors are not negative");
  BasisHeader header;
  header.dims = source.stack->dims();
  header.tile = kTile;
  header.basis = options.basis;
  header.grid = source.grid;
  header.dead_zone = kDeadZone;
  header.rig_toml = source.rig_toml;
  header.rig_hash = source.rig_hash;
  header.lights = source.lights;
  header.requested_relative_l2 = options.relative_l2;
  header.requested_worst_pixel = options.worst_pixel;
  header.source = source.name;
  header.source_hash = source.hash;
  header.source_root = source.root;
  header.photographed = source.photographed;
  header.content = source.content;
  header.program = "haarlight " HAARLIGHT_VERSION;
  require_basis(source, options);
  const StackDims& dims = header.dims;
  if (source.plate != nullptr) {
    const StackDims plate = source.plate->dims();
    if (plate.width != dims.width || plate.height != dims.height ||
        plate.n_lights != dims.n_lights ||
        (plate.channels != 1 && plate.channels != dims.channels)) {
      throw Error(
          fmt::format(
              "the clean plate is {} x {} pixels, {} channels, {} lights; the capture is "
              "{} x {}, {}, {}",
              plate.width, plate.height, plate.channels, plate.n_lights, dims.width,
              dims.height, dims.channels, dims.n_lights),
          source.plate_source, "give the clean plate of this rig, or --plate none");
    }
  }
  if (options.is_integer) {
    if (source.units.size() != static_cast<std::size_t>(dims.n_lights)) {
      throw Error("the values are no whole steps of a camera", source.location,
                  "use --max-error 0, which keeps every float");
    }
    header.coding = BasisCoding::integers;
    header.units = source.units;
    header.requested_relative_l2 = std::numeric_limits<double>::infinity();
  } else if (options.relative_l2 == 0.0 || options.worst_pixel == 0.0) {
    header.coding = BasisCoding::lossless;
  }
  return header;
}

namespace {

TileCoding first_coding(const CompressSource& source, const CompressOptions& options) {
  TileCoding coding;
  coding.header = first_header(source, options);
  coding.basis = make_basis(coding.header);
  coding.plate = source.plate;
  coding.worst_pixel = options.worst_pixel;
  coding.source = source.location;
  return coding;
}

/// Blocks of a tile row as one piece: for every tile and channel the pixel block, then the
/// groups; before each its bytes and entries.
std::vector<std::byte> pack_pieces(const std::vector<PackedTile>& channels) {
  std::vector<std::byte> bytes;
  const auto append = [&bytes](const void* from, std::size_t n) {
    const auto* first = static_cast<const std::byte*>(from);
    bytes.insert(bytes.end(), first, first + n);
  };
  const auto append_block = [&](const PackedTile::Block& block) {
    const auto n_bytes = static_cast<std::uint32_t>(block.bytes.size());
    append(&n_bytes, sizeof(n_bytes));
    append(&block.n_entries, sizeof(block.n_entries));
    append(block.bytes.data(), block.bytes.size());
  };
  for (const PackedTile& channel : channels) {
    append_block(channel.pixels);
    for (const PackedTile::Block& group : channel.groups) {
      append_block(group);
    }
  }
  return bytes;
}

std::vector<PackedTile> unpack_pieces(std::span<const std::byte> bytes, std::size_t n_groups) {
  const auto take_block = [&bytes] {
    PackedTile::Block block;
    std::uint32_t n_bytes = 0;
    HAARLIGHT_EXPECTS(bytes.size() >= 2 * sizeof(n_bytes), "a piece of this program's");
    std::memcpy(&n_bytes, bytes.data(), sizeof(n_bytes));
    std::memcpy(&block.n_entries, bytes.data() + sizeof(n_bytes), sizeof(n_bytes));
    bytes = bytes.subspan(2 * sizeof(n_bytes));
    HAARLIGHT_EXPECTS(bytes.size() >= n_bytes, "a piece of this program's");
    block.bytes.assign(bytes.begin(), bytes.begin() + n_bytes);
    bytes = bytes.subspan(n_bytes);
    return block;
  };
  std::vector<PackedTile> channels;
  while (!bytes.empty()) {
    PackedTile channel;
    channel.pixels = take_block();
    for (std::size_t g = 0; g < n_groups; ++g) {
      channel.groups.push_back(take_block());
    }
    channels.push_back(std::move(channel));
  }
  return channels;
}

/// Buffers for the tiles in work, as many as are in use at once: a fresh one of megabytes costs
/// as much as filling it.
class TileBuffers {
 public:
  class Lease {
   public:
    Lease(TileBuffers& owner, std::vector<float> values)
        : owner_(&owner), values_(std::move(values)) {}
    ~Lease() {
      if (owner_ != nullptr) {
        owner_->give_back(std::move(values_));
      }
    }
    Lease(Lease&& other) noexcept
        : owner_(std::exchange(other.owner_, nullptr)), values_(std::move(other.values_)) {}
    Lease& operator=(Lease&&) = delete;
    Lease(const Lease&) = delete;
    Lease& operator=(const Lease&) = delete;
    [[nodiscard]] std::vector<float>& values() noexcept { return values_; }

   private:
    TileBuffers* owner_;
    std::vector<float> values_;
  };
  /// Thread-safe. The values are arbitrary.
  [[nodiscard]] Lease lend(std::size_t n) {
    std::vector<float> values;
    {
      const std::lock_guard lock(mutex_);
      if (!idle_.empty()) {
        values = std::move(idle_.back());
        idle_.pop_back();
      }
    }
    values.resize(n);
    return {*this, std::move(values)};
  }

 private:
  void give_back(std::vector<float> values) {
    const std::lock_guard lock(mutex_);
    idle_.push_back(std::move(values));
  }
  std::mutex mutex_;
  std::vector<std::vector<float>> idle_;
};

class Compressor {
 public:
  Compressor(const CompressSource& source, const fs::path& file,
             const CompressOptions& options);
  ~Compressor();
  Compressor(const Compressor&) = delete;
  Compressor& operator=(const Compressor&) = delete;
  CompressSummary run();

 private:
  [[nodiscard]] int n_tile_rows() const { return (dims().height + kTile - 1) / kTile; }
  [[nodiscard]] std::size_t n_tiles_x() const {
    return (count(dims().width) + kTile - 1) / kTile;
  }
  [[nodiscard]] const StackDims& dims() const { return coding_.header.dims; }
  [[nodiscard]] bool is_own(int tile_row) const;
  [[nodiscard]] int rows_at_once() const;
  void load(int y0, int y1);
  [[nodiscard]] std::size_t tiles_at_once() const;
  [[nodiscard]] TileBuffers::Lease read(const TileRect& rect);

  [[nodiscard]] CompressSummary compress();
  void fit_plate();
  [[nodiscard]] StackSample sample();
  [[nodiscard]] StackSample sample_tile_row(int tile_row);
  void keep_fit(std::size_t i_tile, TilePlateFit fit);
  void choose_steps(const StackSample& sample);
  [[nodiscard]] std::string step_key() const;
  void code();
  /// A row of tiles, coded.
  struct TileRow {
    std::vector<PackedTile> channels;
    TileSums sums;
    std::vector<double> products;  ///< of errors, then of terms
  };
  void code_tile_rows(int from, int to, Progress& progress);
  void keep(int tile_row, const TileRow& row) const;
  [[nodiscard]] TileSums sum_tile_rows();
  [[nodiscard]] std::vector<double> sum_products(std::size_t begin, double unit) const;
  void report(const TileSums& sums);
  void write(const TileSums& sums);

  const CompressSource& source_;
  const CompressOptions& options_;
  fs::path file_;
  TileCoding coding_;
  WorkFolder work_;
  CompressSummary summary_;
  bool is_kept_ = false;  ///< a rerun can resume from the pieces
  TileBuffers buffers_;
  std::vector<std::optional<TilePlateFit>> fits_;  ///< of each tile that was looked at
  std::uint64_t fit_bytes_ = 0;
};

std::string job_key(const CompressSource& source, const CompressOptions& options) {
  if (source.key.empty()) {
    return {};
  }
  std::string units;
  for (const double unit : options.is_integer ? source.units : std::vector<double>()) {
    units += fmt::format("{:x} ", std::bit_cast<std::uint64_t>(unit));
  }
  return content_hash(
      fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}", kMethodVersion, HAARLIGHT_VERSION,
                  units, source.key, to_string(source.plate_origin), source.plate_source,
                  to_string(source.content), std::string(to_string(options.basis)),
                  std::bit_cast<std::uint64_t>(options.relative_l2),
                  std::bit_cast<std::uint64_t>(options.worst_pixel)));
}

fs::path work_folder_of(const fs::path& file) {
  fs::path folder = file;
  folder += ".part";
  return folder;
}

Compressor::Compressor(const CompressSource& source, const fs::path& file,
                       const CompressOptions& options)
    : source_(source),
      options_(options),
      file_(file),
      coding_(first_coding(source, options)),
      work_(work_folder_of(file), job_key(source, options)),
      fits_(n_tiles_x() * count(n_tile_rows())) {}

Compressor::~Compressor() {
  if (work_.is_own() && !is_kept_) {
    work_.remove();
  }
}

bool Compressor::is_own(int tile_row) const {
  return tile_row % options_.rank.n == options_.rank.i;
}

int Compressor::rows_at_once() const {
  const int rows = source_.rows != nullptr ? source_.rows->rows_at_once() : dims().height;
  if (rows >= dims().height) {
    return dims().height;
  }
  if (rows < kTile) {
    throw Error(fmt::format("{} rows of the stack fit the memory, a row of tiles needs {}",
                            rows, kTile),
                source_.name, "give a larger --memory", ExitCode::usage);
  }
  return rows / kTile * kTile;
}

void Compressor::load(int y0, int y1) {
  if (source_.rows == nullptr) {
    return;
  }
  const bool is_whole = rows_at_once() == dims().height;  // then each row is computed once
  source_.rows->load_rows(is_whole ? 0 : y0, is_whole ? dims().height : y1);
}

/// A tile being coded: its values, the kept coefficients at 12 bytes each and their packed
/// copies.
std::size_t Compressor::tiles_at_once() const {
  const std::uint64_t values = std::uint64_t{kTile} * kTile * count(dims().n_lights);
  const std::uint64_t products = gram_size(dims().n_lights) * count(dims().channels);
  const std::uint64_t tile_bytes = values * (4 * count(dims().channels) + 34) +
                                   products * (2 * sizeof(float)) +
                                   gram_size(dims().n_lights) * sizeof(double);
  if (tile_bytes > options_.memory_bytes) {
    throw Error(fmt::format("one tile needs {} bytes of memory, the budget is {}", tile_bytes,
                            options_.memory_bytes),
                source_.name, "give a larger --memory");
  }
  return std::clamp<std::size_t>(options_.memory_bytes / tile_bytes, 1, kMaxBatch);
}

TileBuffers::Lease Compressor::read(const TileRect& rect) {
  TileBuffers::Lease tile =
      buffers_.lend(count(dims().channels) * count(rect.n_pixels()) * count(dims().n_lights));
  source_.stack->read_tile(rect, tile.values());
  return tile;
}

void Compressor::fit_plate() {
  if (source_.plate == nullptr || coding_.header.coding == BasisCoding::lossless) {
    return;
  }
  const bool is_integer = coding_.header.coding == BasisCoding::integers;
  const double target =
      kPlateFraction * (is_integer ? kIntegerPlate : coding_.header.requested_relative_l2);
  coding_.vectors = fit_plate_vectors(*source_.plate, target);
  if (coding_.vectors.rank == 0) {
    return;  // the plate is black: nothing to subtract
  }
  BasisHeader& header = coding_.header;
  header.plate = source_.plate_origin;
  header.plate_source = source_.plate_source;
  header.plate_rank = coding_.vectors.rank;
  header.plate_degree = choose_plate_degree(*source_.plate, coding_.vectors, kTile, target);
}

/// All rows of a small picture; of a large one, one row per row of tiles, at a varying height
/// within the tiles.
StackSample Compressor::sample_tile_row(int tile_row) {
  const int tile_y0 = tile_row * kTile;
  const int tile_y1 = std::min(dims().height, tile_y0 + kTile);
  const bool is_small = dims().n_pixels() <= kSmallPicture;
  const int y0 = is_small ? tile_y0 : tile_y0 + (tile_row * 13 + 16) % (tile_y1 - tile_y0);
  const int y1 = is_small ? tile_y1 : y0 + 1;
  if (is_small && options_.rank.n == 1) {
    const int rows = rows_at_once();  // the next rows of tiles find theirs loaded
    const int band_y0 = tile_y0 / rows * rows;
    load(band_y0, std::min(dims().height, band_y0 + rows));
  } else {
    load(y0, y1);
  }
  const std::size_t tiles_x = n_tiles_x();
  std::vector<StackSample> parts(tiles_x);
  const std::size_t batch = tiles_at_once();
  for (std::size_t begin = 0; begin < tiles_x; begin += batch) {
    parallel_for(std::min(batch, tiles_x - begin), 1, [&](std::size_t from, std::size_t to) {
      for (std::size_t i = begin + from; i < begin + to; ++i) {
        const int x0 = static_cast<int>(i) * kTile;
        const TileRect rect{x0, y0, std::min(kTile, dims().width - x0), y1 - y0};
        parts[i] = sample_pixels(coding_, rect, read(rect).values());
      }
    });
  }
  StackSample sum;
  for (std::size_t i = 0; i < tiles_x; ++i) {
    sum.merge(parts[i]);
    keep_fit(count(tile_row) * tiles_x + i, std::move(parts[i].fit));
  }
  summary_.bytes_moved += std::uint64_t{count(dims().width)} * count(y1 - y0) *
                          count(dims().channels) * count(dims().n_lights) * sizeof(float);
  return sum;
}

/// For the pass that codes; tiles that find no room are fitted again.
void Compressor::keep_fit(std::size_t i_tile, TilePlateFit fit) {
  constexpr std::uint64_t kShare = 16;  // of the memory
  if (fit_bytes_ + fit.bytes() <= options_.memory_bytes / kShare) {
    fit_bytes_ += fit.bytes();
    fits_[i_tile] = std::move(fit);
  }
}

StackSample Compressor::sample() {
  const auto name = [](int tile_row) { return fmt::format("sample-{:05}", tile_row); };
  Progress progress("look at the values", count(n_tile_rows()), options_.progress);
  StackSample sum;
  for (int r = 0; r < n_tile_rows(); ++r) {
    if (is_own(r) && !work_.read_numbers(name(r))) {
      const StackSample part = sample_tile_row(r);
      std::vector<double> numbers = part.residuals.to_numbers();
      numbers.insert(numbers.end(), {part.energy, part.peak, part.n_rows});
      work_.write_numbers(name(r), numbers);
    }
    progress.advance();
  }
  options_.rank.wait_for_all();
  for (int r = 0; r < n_tile_rows(); ++r) {
    const std::optional<std::vector<double>> numbers = work_.read_numbers(name(r));
    HAARLIGHT_EXPECTS(numbers && numbers->size() >= 3, "a piece that was just written");
    const std::size_t n = numbers->size() - 3;
    HAARLIGHT_EXPECTS(sum.residuals.add_numbers(std::span(*numbers).first(n)),
                      "a histogram's numbers");
    sum.energy += (*numbers)[n];
    sum.peak = std::max(sum.peak, (*numbers)[n + 1]);
    sum.n_rows += (*numbers)[n + 2];
  }
  return sum;
}

void Compressor::choose_steps(const StackSample& sample) {
  BasisHeader& header = coding_.header;
  const double rms_pixel = std::sqrt(sample.energy / sample.n_rows);
  header.dark_norm = kDarkFloor * rms_pixel;
  if (sample.energy == 0.0) {
    header.step = 1.0;  // the sample is black: nothing will be kept
    header.gain_step = 1.0;
    return;
  }
  const double allowed = header.requested_relative_l2 * std::sqrt(sample.energy);
  header.gain_step = header.plate_rank == 0
                         ? 0.0
                         : kGainStep * std::max(header.requested_relative_l2, 1e-9) * rms_pixel;
  const double margin = dims().n_pixels() <= kSmallPicture ? kStepMargin : kSampledMargin;
  // |<basis vector, T_p>| <= peak * sqrt(n_lights).
  header.step = sample.residuals.choose_step(margin * margin * allowed * allowed,
                                             sample.peak * std::sqrt(double(dims().n_lights)));
  const double n_kept = sample.residuals.n_kept(header.step);
  coding_.has_term_products = n_kept <= kMostProductTerms * sample.n_rows;
  coding_.content = n_kept > kDenseFraction * dims().n_lights * sample.n_rows
                        ? BlockContent::dense
                        : BlockContent::repeats;
}

/// What a coded tile row depends on besides the job.
std::string Compressor::step_key() const {
  return fmt::format("{} {} {} {:x} {:x} {:x}", to_string(coding_.header.coding),
                     coding_.has_term_products, coding_.content == BlockContent::dense,
                     std::bit_cast<std::uint64_t>(coding_.header.step),
                     std::bit_cast<std::uint64_t>(coding_.header.gain_step),
                     std::bit_cast<std::uint64_t>(coding_.header.dark_norm));
}

std::string blocks_name(int tile_row) { return fmt::format("blocks-{:05}", tile_row); }
std::string products_name(int tile_row) { return fmt::format("products-{:05}", tile_row); }
std::string sums_name(int tile_row) { return fmt::format("sums-{:05}", tile_row); }

void Compressor::code() {
  const bool is_lossless = coding_.header.coding != BasisCoding::quantised;
  const std::string key = step_key();
  Progress progress(is_lossless ? "code (exact)" : "code", count(n_tile_rows()),
                    options_.progress);
  const int rows = rows_at_once();
  for (int y0 = 0; y0 < dims().height; y0 += rows) {
    const int from = y0 / kTile;
    const int to = (std::min(dims().height, y0 + rows) + kTile - 1) / kTile;
    std::vector<int> wanted;
    for (int r = from; r < to; ++r) {
      if (!is_own(r)) {
        progress.advance();
      } else if (work_.read_numbers(sums_name(r), key) && work_.read(blocks_name(r), key) &&
                 (is_lossless || work_.read(products_name(r), key))) {
        ++summary_.n_rows_found;
        progress.advance();
      } else {
        wanted.push_back(r);
      }
    }
    // Neighbours in one load, gaps apart.
    for (std::size_t i = 0; i < wanted.size();) {
      std::size_t j = i + 1;
      while (j < wanted.size() && wanted[j] == wanted[j - 1] + 1) {
        ++j;
      }
      code_tile_rows(wanted[i], wanted[j - 1] + 1, progress);
      i = j;
    }
  }
  options_.rank.wait_for_all();
}

/// Adds some tiles' products of errors, then of terms, each tile after the one before.
void add_products(std::span<const CodedTile> tiles, std::vector<double>& sums) {
  constexpr std::size_t kGrain = std::size_t{1} << 16U;
  const std::size_t n_errors = tiles.front().error_products.size();
  sums.resize(n_errors + tiles.front().term_products.size());
  parallel_for(sums.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (const CodedTile& tile : tiles) {
      for (std::size_t i = begin; i < std::min(end, n_errors); ++i) {
        sums[i] += tile.error_products[i];
      }
      for (std::size_t i = std::max(begin, n_errors); i < end; ++i) {
        sums[i] += double{tile.term_products[i - n_errors]};
      }
    }
  });
}

/// Tile rows [from, to): loaded together, coded tile by tile in parallel, kept one by one.
void Compressor::code_tile_rows(int from, int to, Progress& progress) {
  const int y1 = std::min(dims().height, to * kTile);
  load(from * kTile, y1);
  const std::size_t tiles_x = n_tiles_x();
  const std::size_t n_tiles = tiles_x * count(to - from);
  const std::size_t batch = tiles_at_once();
  std::vector<CodedTile> coded(std::min(batch, n_tiles));
  TileRow row{{}, TileSums(dims()), {}};
  for (std::size_t begin = 0; begin < n_tiles; begin += batch) {
    const std::size_t size = std::min(batch, n_tiles - begin);
    parallel_for(size, 1, [&](std::size_t first, std::size_t last) {
      for (std::size_t i = first; i < last; ++i) {
        const std::size_t t = count(from) * tiles_x + begin + i;
        const int x0 = static_cast<int>(t % tiles_x) * kTile;
        const int y0 = static_cast<int>(t / tiles_x) * kTile;
        const TileRect rect{x0, y0, std::min(kTile, dims().width - x0),
                            std::min(kTile, dims().height - y0)};
        coded[i] = code_tile(coding_, rect, read(rect).values(),
                             source_.stack->clipped_in(rect), fits_[t] ? &*fits_[t] : nullptr);
      }
    });
    for (std::size_t i = 0; i < size;) {
      // Up to the end of this row of tiles.
      const std::size_t end = std::min(size, i + tiles_x - (begin + i) % tiles_x);
      add_products(std::span(coded).subspan(i, end - i), row.products);
      for (; i < end; ++i) {
        row.sums.add(coded[i].sums);
        std::move(coded[i].channels.begin(), coded[i].channels.end(),
                  std::back_inserter(row.channels));
        coded[i] = {};
      }
      if ((begin + end) % tiles_x == 0) {
        keep(from + static_cast<int>((begin + end) / tiles_x) - 1, row);
        row = {{}, TileSums(dims()), {}};
        progress.advance();
      }
    }
  }
  summary_.bytes_moved += std::uint64_t{count(dims().width)} * count(y1 - from * kTile) *
                          count(dims().channels) * count(dims().n_lights) * sizeof(float);
}

void Compressor::keep(int tile_row, const TileRow& row) const {
  const std::string key = step_key();
  work_.write(blocks_name(tile_row), pack_pieces(row.channels), key);
  if (!row.products.empty()) {
    const std::vector<float> rounded(row.products.begin(), row.products.end());
    work_.write(products_name(tile_row), std::as_bytes(std::span(rounded)), key);
  }
  work_.write_numbers(sums_name(tile_row), row.sums.to_numbers(), key);  // last: marks "done"
}

TileSums Compressor::sum_tile_rows() {
  TileSums sums(dims());
  TileSums part(dims());
  for (int r = 0; r < n_tile_rows(); ++r) {
    const std::optional<std::vector<double>> numbers =
        work_.read_numbers(sums_name(r), step_key());
    HAARLIGHT_EXPECTS(numbers && part.set_numbers(*numbers), "a tile row that was just coded");
    sums.add(part);
  }
  return sums;
}

/// Products of all rows of tiles, (channels, gram_size); a row's are floats, with an error of
/// at most 2^-24 of the norms.
std::vector<double> Compressor::sum_products(std::size_t begin, double unit) const {
  std::vector<double> products(count(dims().channels) * gram_size(dims().n_lights));
  for (int r = 0; r < n_tile_rows(); ++r) {
    const auto piece = work_.read(products_name(r), step_key());
    HAARLIGHT_EXPECTS(piece && piece->size() >= (begin + products.size()) * sizeof(float),
                      "a tile row that was just coded");
    const std::byte* from = piece->data() + begin * sizeof(float);
    for (std::size_t i = 0; i < products.size(); ++i) {
      float product = 0.0F;
      std::memcpy(&product, from + i * sizeof(float), sizeof(float));
      products[i] += unit * double{product};
    }
  }
  return products;
}

void Compressor::report(const TileSums& sums) {
  BasisHeader& header = coding_.header;
  double energy = 0.0;
  double error = 0.0;
  for (std::size_t i = 0; i < sums.light_energy.size(); ++i) {
    energy += sums.light_energy[i];
    error += sums.light_error[i];
  }
  header.stack_norm = std::sqrt(energy);
  header.peak = sums.peak;
  header.achieved.relative_l2 = energy > 0.0 ? std::sqrt(error / energy) : 0.0;
  header.achieved.worst_pixel = sums.worst_pixel;
  header.achieved.worst_value = sums.peak > 0.0 ? sums.worst_value / sums.peak : 0.0;
  if (source_.stack->tells_clipped()) {
    ClippedValues clipped;
    clipped.n_values = std::accumulate(sums.clipped.begin(), sums.clipped.end(), 0.0);
    const double least =
        std::accumulate(sums.clipped_energy.begin(), sums.clipped_energy.end(), 0.0);
    clipped.least_norm = energy > 0.0 ? std::sqrt(least / energy) : 0.0;
    header.clipped = clipped;
  }
  header.mean_coefficients =
      sums.n_coefficients / (double(dims().channels) * double(dims().n_pixels()));
  summary_.header = header;
  summary_.worst_light = 0.0;
  for (std::size_t i = 0; i < sums.light_energy.size(); ++i) {
    if (sums.light_energy[i] > 0.0) {
      summary_.worst_light =
          std::max(summary_.worst_light, std::sqrt(sums.light_error[i] / sums.light_energy[i]));
    }
  }
}

/// The file from the tile rows; it gets its name when it is complete.
void Compressor::write(const TileSums& sums) {
  if (options_.rank.i == 0) {
    BasisTables tables;
    tables.plate_vectors = coding_.vectors.vectors;
    tables.coefficient_norms = root_round_up(sums.coefficient_energy);
    tables.coefficient_errors = root_round_up(sums.coefficient_error);
    tables.light_norms = root_round_up(sums.light_energy);
    tables.light_errors = root_round_up(sums.light_error);
    if (coding_.header.clipped && coding_.header.clipped->n_values > 0.0) {
      tables.clipped_counts.assign(sums.clipped.begin(), sums.clipped.end());
      tables.clipped_norms = root_round_up(sums.clipped_energy);
    }
    const fs::path whole = work_.path("whole.hlb");
    BasisWriter writer(whole);
    double block_bytes = 0.0;
    for (int r = 0; r < n_tile_rows(); ++r) {
      const std::optional<std::vector<std::byte>> blocks =
          work_.read(blocks_name(r), step_key());
      HAARLIGHT_EXPECTS(blocks.has_value(), "a tile row that was just coded");
      for (const PackedTile& channel :
           unpack_pieces(*blocks, coding_.header.group_ends.size())) {
        writer.append(channel);
      }
      block_bytes += static_cast<double>(blocks->size());
    }
    if (coding_.header.coding == BasisCoding::quantised) {
      const double unit = gram_scale(coding_.header) * gram_scale(coding_.header);
      std::vector<double> rests = sums.gram_rests;
      for (double& rest : rests) {
        rest *= std::sqrt(double(dims().n_pixels()));
      }
      tables.coded_bound = fit_picture_bound(coding_.header, sum_products(0, unit),
                                             tables.coefficient_errors, rests, block_bytes);
      if (coding_.has_term_products) {
        std::fill(rests.begin(), rests.end(), 0.0);
        const std::size_t behind = count(dims().channels) * gram_size(dims().n_lights);
        const double term = term_unit(coding_.header) * term_unit(coding_.header);
        tables.term_bound = fit_picture_bound(coding_.header, sum_products(behind, term),
                                              tables.coefficient_norms, rests, block_bytes);
      }
    }
    summary_.bytes = writer.finish(coding_.header, tables);
    rename_durably(whole, file_);
  }
  options_.rank.wait_for_all();
  if (options_.rank.i != 0) {
    summary_.bytes = fs::file_size(file_);
  }
}

CompressSummary Compressor::run() {
  if (options_.rank.i == 0) {
    work_.own();
  }
  options_.rank.wait_for_all();
  try {
    return compress();
  } catch (const Error& error) {
    // Bad input stays bad in a rerun; a full disk need not.
    is_kept_ = error.code() == ExitCode::io && !source_.key.empty();
    throw;
  }
}

CompressSummary Compressor::compress() {
  BasisHeader& header = coding_.header;
  auto since = std::chrono::steady_clock::now();
  const auto lap = [&since] {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(since, now)).count();
  };
  if (header.coding == BasisCoding::quantised) {
    fit_plate();
    summary_.seconds_plate = lap();
    choose_steps(sample());
  } else if (header.coding == BasisCoding::integers) {
    fit_plate();
    // The gain's rounding costs a light an eighth of a unit.
    header.gain_step = 0.25 * *std::min_element(header.units.begin(), header.units.end()) *
                       std::sqrt(double(dims().n_lights));
  }
  summary_.seconds_looked = lap();
  for (int attempt = 0;; ++attempt) {
    if (attempt == kMaxAttempts) {
      // Floats have 24 bits: an error below their rounding is achieved by keeping them all.
      header.coding = BasisCoding::lossless;
    }
    if (header.coding == BasisCoding::lossless) {
      header.plate = PlateOrigin::none;
      header.plate_source.clear();
      header.plate_rank = 0;
      header.plate_degree = 0;
      header.gain_step = 0.0;
      header.step = 0.0;
      coding_.vectors = {};
    }
    header.group_ends = default_group_ends(header);
    code();
    if (source_.rows != nullptr) {
      source_.rows->finish();
    }
    const TileSums sums = sum_tile_rows();
    report(sums);
    summary_.seconds_coded += lap();
    if (header.coding != BasisCoding::quantised || summary_.is_achieved()) {
      write(sums);
      summary_.seconds_written = lap();
      break;
    }
    const double excess = header.achieved.relative_l2 / header.requested_relative_l2;
    header.step *= std::min(0.99, kStepMargin / std::max(excess, 1e-3));
  }
  return summary_;
}

}  // namespace

CompressSummary compress_stack(const CompressSource& source, const fs::path& file,
                               const CompressOptions& options) {
  return Compressor(source, file, options).run();
}

}  // namespace haarlight::relight
