// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/basis_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <numeric>
#include <utility>

#include <fmt/format.h>

#include "core/count.h"
#include "core/pick_columns.h"
#include "haarlight/core/error.h"
#include "relight/basis/basis_header.h"
#include "relight/basis/coder/integer_coding.h"
#include "relight/basis/error_gram.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/plate/tile_plate.h"

namespace haarlight::relight {

namespace {

constexpr std::array<unsigned char, 8> kMagic = {0x89, 'H', 'L', 'B', '\r', '\n', 0x1a, '\n'};
constexpr std::size_t kPreambleBytes = 104;
constexpr std::size_t kEntryBytes = 24;
constexpr std::uint64_t kMaxHeaderBytes = std::uint64_t{64} << 20U;

/// The first 104 bytes, little-endian.
struct Preamble {
  std::uint32_t version = kBasisVersion;
  std::uint32_t reserved = 0;
  std::uint64_t file_bytes = 0;
  std::array<std::uint64_t, 3> header{};  ///< offset, bytes, checksum
  std::array<std::uint64_t, 3> index{};
  std::array<std::uint64_t, 3> tables{};
};

template <class T>
void put(std::byte* to, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    to[i] = static_cast<std::byte>((std::uint64_t{value} >> (8 * i)) & 0xffU);
  }
}

template <class T>
T get(const std::byte* from) {
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) {
    value |= std::to_integer<std::uint64_t>(from[i]) << (8 * i);
  }
  return static_cast<T>(value);
}

std::array<std::byte, kPreambleBytes> to_bytes(const Preamble& preamble) {
  std::array<std::byte, kPreambleBytes> bytes{};
  std::memcpy(bytes.data(), kMagic.data(), kMagic.size());
  put(bytes.data() + 8, preamble.version);
  put(bytes.data() + 12, preamble.reserved);
  put(bytes.data() + 16, preamble.file_bytes);
  std::byte* to = bytes.data() + 24;
  for (const auto* part : {&preamble.header, &preamble.index, &preamble.tables}) {
    for (const std::uint64_t number : *part) {
      put(to, number);
      to += 8;
    }
  }
  put(bytes.data() + 96, block_checksum(std::span(bytes).first(96)));
  return bytes;
}

[[noreturn]] void throw_damaged(const std::string& what, const std::string& where) {
  throw Error(what, where, "copy the file again, or make it again with haarlight compress");
}

Preamble read_preamble(std::span<const std::byte> bytes, const std::string& name) {
  if (bytes.size() < kMagic.size() ||
      std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) != 0) {
    throw Error("not a basis file", name,
                "give a .hlb file that haarlight compress has written");
  }
  if (bytes.size() < kPreambleBytes) {
    throw_damaged("the basis file ends within its first 104 bytes", name);
  }
  Preamble preamble;
  preamble.version = get<std::uint32_t>(bytes.data() + 8);
  if (preamble.version < kOldestBasisVersion || preamble.version > kBasisVersion) {
    throw Error(fmt::format("basis file of version {}, this program reads versions {} to {}",
                            preamble.version, kOldestBasisVersion, kBasisVersion),
                name, "use a newer haarlight, or compress the session again");
  }
  if (get<std::uint64_t>(bytes.data() + 96) != block_checksum(bytes.first(96))) {
    throw_damaged("the first bytes of the basis file are damaged (checksum)", name);
  }
  preamble.file_bytes = get<std::uint64_t>(bytes.data() + 16);
  const std::byte* from = bytes.data() + 24;
  for (auto* part : {&preamble.header, &preamble.index, &preamble.tables}) {
    for (std::uint64_t& number : *part) {
      number = get<std::uint64_t>(from);
      from += 8;
    }
  }
  if (preamble.file_bytes != bytes.size()) {
    throw_damaged(fmt::format("the basis file has {} bytes, it was written with {}",
                              bytes.size(), preamble.file_bytes),
                  name);
  }
  return preamble;
}

std::span<const std::byte> checked_part(std::span<const std::byte> bytes,
                                        const std::array<std::uint64_t, 3>& part,
                                        const std::string& what, const std::string& name) {
  const auto [offset, size, checksum] = part;
  if (offset > bytes.size() || size > bytes.size() - offset) {
    throw_damaged(fmt::format("the {} lies outside the file", what), name);
  }
  const auto found = bytes.subspan(offset, size);
  if (block_checksum(found) != checksum) {
    throw_damaged(
        fmt::format("the {} is damaged (checksum): {} bytes from byte {}", what, size, offset),
        name);
  }
  return found;
}

/// Every byte belongs to one part and is covered by its checksum.
void require_no_loose_bytes(const Preamble& preamble, const std::vector<BlockEntry>& index,
                            const std::vector<BasisSection>& sections,
                            const std::string& name) {
  std::vector<std::pair<std::uint64_t, std::uint64_t>> parts = {{0, kPreambleBytes}};
  for (const auto* part : {&preamble.header, &preamble.index, &preamble.tables}) {
    parts.emplace_back((*part)[0], (*part)[1]);
  }
  for (const BlockEntry& block : index) {
    parts.emplace_back(block.offset, block.bytes);
  }
  for (const BasisSection& section : sections) {
    parts.emplace_back(section.offset, section.bytes);
  }
  std::erase_if(parts, [](const auto& part) { return part.second == 0; });
  std::sort(parts.begin(), parts.end());
  parts.emplace_back(preamble.file_bytes, 0);
  std::uint64_t end = 0;
  for (const auto& [offset, size] : parts) {
    if (offset != end) {
      throw_damaged(offset > end ? fmt::format("bytes {} to {} belong to nothing", end, offset)
                                 : fmt::format("two parts share byte {}", offset),
                    name);
    }
    end = offset + size;
  }
}

std::size_t table_values(const BasisHeader& header) {
  return count(header.dims.n_lights) *
         (count(header.plate_rank) + 4 * count(header.dims.channels));
}

std::vector<float> tables_to_floats(const BasisTables& tables) {
  std::vector<float> all;
  for (const auto* part :
       {&tables.plate_vectors, &tables.coefficient_norms, &tables.coefficient_errors,
        &tables.light_norms, &tables.light_errors}) {
    all.insert(all.end(), part->begin(), part->end());
  }
  return all;
}

BasisTables tables_from_floats(const std::vector<float>& all, const BasisHeader& header) {
  BasisTables tables;
  const std::size_t per_channel = count(header.dims.channels) * count(header.dims.n_lights);
  auto from = all.begin();
  const auto take = [&from](std::size_t n) {
    const auto begin = from;
    from += static_cast<std::ptrdiff_t>(n);
    return std::vector<float>(begin, from);
  };
  tables.plate_vectors = take(count(header.plate_rank) * count(header.dims.n_lights));
  tables.coefficient_norms = take(per_channel);
  tables.coefficient_errors = take(per_channel);
  tables.light_norms = take(per_channel);
  tables.light_errors = take(per_channel);
  return tables;
}

constexpr std::string_view kClippedSection = "clipped";
constexpr std::string_view kCodedBoundSection = "coded_bound";
constexpr std::string_view kTermBoundSection = "term_bound";

/// Norms, counts and the like: finite and not negative.
void require_bounds(std::span<const float> values, const std::string& where) {
  if (!std::all_of(values.begin(), values.end(),
                   [](float v) { return std::isfinite(v) && v >= 0.0F; })) {
    throw_damaged("a bound is negative or no finite number", where);
  }
}

std::size_t n_picture_blocks(const BasisHeader& header) {
  return count(header.dims.channels) * count(n_gram_blocks(header.dims.n_lights));
}

/// The number of floats, if it is that of a bound for this header.
std::size_t picture_bound_values(const BasisHeader& header, std::uint64_t n,
                                 const std::string& where) {
  const std::size_t per_vector = count(header.dims.channels) * count(header.dims.n_lights);
  const std::size_t without = 2 * n_picture_blocks(header);
  // Many times what is ever written; all that n lights allow would let a short file claim
  // gigabytes.
  constexpr std::size_t kMostVectors = 256;
  if (n < without || (n - without) % per_vector != 0 ||
      (n - without) / per_vector > std::min(kMostVectors, count(header.dims.n_lights))) {
    throw_damaged(fmt::format("{} numbers are no bound", n), where);
  }
  return n;
}

std::vector<float> picture_bound_to_floats(const PictureBound& bound) {
  std::vector<float> all;
  for (const auto* part : {&bound.fractions, &bound.rests, &bound.vectors}) {
    all.insert(all.end(), part->begin(), part->end());
  }
  return all;
}

PictureBound picture_bound_from_floats(const std::vector<float>& all, const BasisHeader& header,
                                       const std::string& where) {
  PictureBound bound;
  const auto blocks = static_cast<std::ptrdiff_t>(n_picture_blocks(header));
  bound.fractions.assign(all.begin(), all.begin() + blocks);
  bound.rests.assign(all.begin() + blocks, all.begin() + 2 * blocks);
  require_bounds(bound.fractions, where);
  require_bounds(bound.rests, where);
  bound.vectors.assign(all.begin() + 2 * blocks, all.end());
  if (!std::all_of(bound.vectors.begin(), bound.vectors.end(),
                   [](float v) { return std::isfinite(v); })) {
    throw_damaged("a number of a bound is not finite", where);
  }
  bound.n_vectors = static_cast<int>(
      bound.vectors.size() / (count(header.dims.channels) * count(header.dims.n_lights)));
  return bound;
}

}  // namespace

namespace {

/// The basis whose order a file's coefficients have: only quantised files store coefficients.
std::shared_ptr<const FixedBasis> stored_basis(const BasisHeader& header) {
  return header.coding == BasisCoding::quantised
             ? make_basis(header)
             : make_basis(BasisKind::direct, {}, header.dims.n_lights);
}

}  // namespace

std::vector<int> coefficient_order(const BasisHeader& header) {
  return stored_basis(header)->order();
}

std::vector<int> default_group_ends(const BasisHeader& header) {
  return stored_basis(header)->group_ends();
}

BasisFile BasisFile::open(const std::filesystem::path& file) {
  BasisFile basis;
  basis.mapping_ = MappedFile(file);
  basis.bytes_ = basis.mapping_.bytes();
  basis.name_ = file.string();
  basis.parse();
  return basis;
}

BasisFile BasisFile::from_bytes(std::span<const std::byte> bytes, const std::string& name) {
  BasisFile basis;
  basis.bytes_ = bytes;
  basis.name_ = name;
  basis.parse();
  return basis;
}

void BasisFile::parse() {
  const Preamble preamble = read_preamble(bytes_, name_);
  if (preamble.header[1] > kMaxHeaderBytes) {
    throw_damaged("the header is larger than any header", name_);
  }
  const auto header = checked_part(bytes_, preamble.header, "header", name_);
  header_ = basis_header_from_json(
      std::string(reinterpret_cast<const char*>(header.data()), header.size()), name_);
  basis_ = make_basis(header_);
  tiles_x_ = (header_.dims.width + header_.tile - 1) / header_.tile;
  tiles_y_ = (header_.dims.height + header_.tile - 1) / header_.tile;

  const auto index = checked_part(bytes_, preamble.index, "index", name_);
  const std::size_t n_blocks =
      count(n_tiles()) * count(header_.dims.channels) * (header_.group_ends.size() + 1);
  if (index.size() != n_blocks * kEntryBytes) {
    throw_damaged("the index has the wrong size", name_);
  }
  index_.resize(n_blocks);
  for (std::size_t i = 0; i < n_blocks; ++i) {
    const std::byte* from = index.data() + i * kEntryBytes;
    BlockEntry& entry = index_[i];
    entry.offset = get<std::uint64_t>(from);
    entry.checksum = get<std::uint64_t>(from + 8);
    entry.bytes = get<std::uint32_t>(from + 16);
    entry.n_entries = get<std::uint32_t>(from + 20);
    if (entry.offset > bytes_.size() || entry.bytes > bytes_.size() - entry.offset) {
      throw_damaged("a block lies outside the file", name_);
    }
  }
  require_no_loose_bytes(preamble, index_, header_.sections, name_);

  const auto tables = checked_part(bytes_, preamble.tables, "table part", name_);
  tables_ = tables_from_floats(
      decode_floats(tables, 1, table_values(header_), name_ + ", tables"), header_);
  read_sections();
  order_ = coefficient_order(header_);
}

void BasisFile::read_sections() {
  for (const BasisSection& section : header_.sections) {
    const auto bytes = checked_part(bytes_, {section.offset, section.bytes, section.checksum},
                                    fmt::format("section '{}'", section.name), name_);
    const std::string where = fmt::format("{}, section '{}'", name_, section.name);
    const std::size_t per_channel = count(header_.dims.channels) * count(header_.dims.n_lights);
    if (section.name == kClippedSection) {
      if (section.n_values != 2 * per_channel) {
        throw_damaged("the numbers of clipped values are not two per light", where);
      }
      const std::vector<float> values = decode_floats(bytes, 1, 2 * per_channel, where);
      require_bounds(values, where);
      const auto half = values.begin() + static_cast<std::ptrdiff_t>(per_channel);
      tables_.clipped_counts.assign(values.begin(), half);
      tables_.clipped_norms.assign(half, values.end());
    } else if (section.name == kCodedBoundSection || section.name == kTermBoundSection) {
      const std::size_t n = picture_bound_values(header_, section.n_values, where);
      (section.name == kTermBoundSection ? tables_.term_bound : tables_.coded_bound) =
          picture_bound_from_floats(decode_floats(bytes, 1, n, where), header_, where);
    }
  }
}

TileRect BasisFile::tile_rect(int i_tile) const {
  HAARLIGHT_EXPECTS(i_tile >= 0 && i_tile < n_tiles(), "a tile of the file");
  const int x0 = i_tile % tiles_x_ * header_.tile;
  const int y0 = i_tile / tiles_x_ * header_.tile;
  return {x0, y0, std::min(header_.tile, header_.dims.width - x0),
          std::min(header_.tile, header_.dims.height - y0)};
}

std::string BasisFile::content_key() const {
  // The preamble holds the index's checksum, and the index those of all blocks.
  return content_hash(bytes_.first(kPreambleBytes));
}

std::vector<int> BasisFile::tiles_of(const TileRect& rect) const {
  std::vector<int> tiles;
  for (int y = rect.y0 / header_.tile; y * header_.tile < rect.y0 + rect.height; ++y) {
    for (int x = rect.x0 / header_.tile; x * header_.tile < rect.x0 + rect.width; ++x) {
      tiles.push_back(y * tiles_x_ + x);
    }
  }
  return tiles;
}

const BlockEntry& BasisFile::entry(int i_tile, int channel, int block) const {
  HAARLIGHT_EXPECTS(channel >= 0 && channel < header_.dims.channels, "a channel of the file");
  const std::size_t per_channel = header_.group_ends.size() + 1;
  return index_[(count(i_tile) * count(header_.dims.channels) + count(channel)) * per_channel +
                count(block)];
}

std::string BasisFile::block_name(int i_tile, int channel, int block) const {
  return fmt::format("{}, tile {}, channel {}, {} (from byte {})", name_, i_tile, channel,
                     block == 0 ? "pixels" : fmt::format("group {}", block - 1),
                     entry(i_tile, channel, block).offset);
}

std::span<const std::byte> BasisFile::block_bytes(int i_tile, int channel, int block) const {
  const BlockEntry& found = entry(i_tile, channel, block);
  const auto bytes = bytes_.subspan(found.offset, found.bytes);
  if (block_checksum(bytes) != found.checksum) {
    throw_damaged("a block is damaged (checksum)", block_name(i_tile, channel, block));
  }
  return bytes;
}

PixelBlock BasisFile::pixels(int i_tile, int channel) const {
  const TileRect rect = tile_rect(i_tile);
  return decode_pixels(block_bytes(i_tile, channel, 0), count(rect.n_pixels()),
                       count(header_.n_plate()), block_name(i_tile, channel, 0));
}

bool BasisFile::is_group_empty(int i_tile, int channel, int group) const {
  return entry(i_tile, channel, group + 1).bytes == 0;
}

std::uint32_t BasisFile::group_bytes(int i_tile, int channel, int group) const {
  return entry(i_tile, channel, group + 1).bytes;
}

SparseBlock BasisFile::sparse(int i_tile, int channel, int group) const {
  HAARLIGHT_EXPECTS(header_.coding == BasisCoding::quantised, "a quantised file");
  const TileRect rect = tile_rect(i_tile);
  const std::size_t n_cells =
      count(group_end(group) - group_begin(group)) * count(rect.n_pixels());
  return decode_sparse(block_bytes(i_tile, channel, group + 1),
                       entry(i_tile, channel, group + 1).n_entries, n_cells,
                       block_name(i_tile, channel, group + 1));
}

std::vector<float> BasisFile::floats(int i_tile, int channel, int group) const {
  HAARLIGHT_EXPECTS(header_.coding != BasisCoding::quantised, "no quantised file");
  const TileRect rect = tile_rect(i_tile);
  if (header_.coding == BasisCoding::integers) {
    const std::vector<float> all = decode_integers_of(i_tile, channel);
    const std::size_t n_pixels = count(rect.n_pixels());
    std::vector<float> rows;
    rows.reserve(count(group_end(group) - group_begin(group)) * n_pixels);
    for (int k = group_begin(group); k < group_end(group); ++k) {
      for (std::size_t p = 0; p < n_pixels; ++p) {
        rows.push_back(all[p * count(header_.dims.n_lights) + count(k)]);
      }
    }
    return rows;
  }
  return decode_floats(block_bytes(i_tile, channel, group + 1),
                       count(group_end(group) - group_begin(group)), count(rect.n_pixels()),
                       block_name(i_tile, channel, group + 1));
}

std::vector<float> BasisFile::decode_integers_of(int i_tile, int channel) const {
  const TileRect rect = tile_rect(i_tile);
  const std::size_t n_pixels = count(rect.n_pixels());
  const std::size_t n_lights = count(header_.dims.n_lights);
  std::vector<std::int64_t> numbers(n_pixels * n_lights);  // (pixels, lights)
  for (int g = 0; g < n_groups(); ++g) {
    const std::vector<std::int32_t> rows = decode_integers(
        block_bytes(i_tile, channel, g + 1), count(group_end(g) - group_begin(g)), n_pixels,
        block_name(i_tile, channel, g + 1));
    for (int k = group_begin(g); k < group_end(g); ++k) {
      const std::size_t row = count(k - group_begin(g)) * n_pixels;
      for (std::size_t p = 0; p < n_pixels; ++p) {
        numbers[p * n_lights + count(k)] = rows[row + p];
      }
    }
  }
  const PixelBlock pixel_block = pixels(i_tile, channel);
  IntegerPrediction prediction(header_, tables_.plate_vectors, rect, pixel_block.plate);
  std::vector<float> out(n_pixels * n_lights);
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<std::int64_t> row = std::span(numbers).subspan(p * n_lights, n_lights);
    basis_->inverse_integers(row);
    const std::span<const std::int32_t> predicted = prediction.of(p, pixel_block.gain[p]);
    for (std::size_t k = 0; k < n_lights; ++k) {
      const std::int64_t n = row[k] + predicted[k];
      out[p * n_lights + k] = static_cast<float>(static_cast<double>(n) * header_.units[k]);
    }
  }
  return out;
}

namespace {

/// Lights' rows of pixels into pixels' rows of `stride` lights. By squares of 16, so that each line
/// of the cache is read and written once.
void put_lights(std::span<const float> rows, std::size_t n_pixels, std::size_t stride,
                float* out) {
  constexpr std::size_t kSide = 16;
  const std::size_t n_lights = rows.size() / n_pixels;
  std::array<float, kSide * kSide> square{};
  for (std::size_t k0 = 0; k0 < n_lights; k0 += kSide) {
    const std::size_t n_k = std::min(kSide, n_lights - k0);
    for (std::size_t p0 = 0; p0 < n_pixels; p0 += kSide) {
      const std::size_t n_p = std::min(kSide, n_pixels - p0);
      for (std::size_t k = 0; k < n_k; ++k) {
        const float* from = rows.data() + (k0 + k) * n_pixels + p0;
        for (std::size_t p = 0; p < n_p; ++p) {
          square[p * kSide + k] = from[p];
        }
      }
      for (std::size_t p = 0; p < n_p; ++p) {
        std::copy_n(square.data() + p * kSide, n_k, out + (p0 + p) * stride + k0);
      }
    }
  }
}

/// What the clean plate adds to a tile's pixels.
class PlateShare {
 public:
  /// @param terms  plate_terms() of the tile @param vectors  (rank, n_lights)
  PlateShare(double gain_step, const PixelBlock& pixels, std::span<const double> terms,
             std::span<const float> vectors, std::size_t n_lights)
      : gain_step_(gain_step),
        pixels_(pixels),
        terms_(terms),
        n_terms_(terms.size() / pixels.gain.size()),
        vectors_(vectors),
        direction_(n_lights) {}

  /// To the lights of pixel p.
  void add(std::size_t p, std::span<double> row) {
    if (pixels_.gain[p] == 0) {
      return;
    }
    const double gain = gain_step_ * pixels_.gain[p];
    plate_direction<double>(pixels_.plate, terms_.subspan(p * n_terms_, n_terms_), vectors_,
                            direction_);
    std::transform(row.begin(), row.end(), direction_.begin(), row.begin(),
                   [gain](double v, double d) { return v + gain * d; });
  }

 private:
  double gain_step_;
  const PixelBlock& pixels_;
  std::span<const double> terms_;
  std::size_t n_terms_;
  std::span<const float> vectors_;
  std::vector<double> direction_;
};

}  // namespace

std::vector<float> BasisFile::coefficients_of(int i_tile, int channel,
                                              const PixelBlock& pixel_block,
                                              std::span<const int> column_of,
                                              std::size_t n_columns) const {
  const std::size_t n_pixels = count(tile_rect(i_tile).n_pixels());
  std::vector<double> steps(n_pixels);
  std::transform(pixel_block.shift.begin(), pixel_block.shift.end(), steps.begin(),
                 [this](auto shift) { return std::ldexp(header_.step, -int{shift}); });
  std::vector<float> out(n_pixels * n_columns);
  // Small numbers as integers first (exact), then one multiplication by the pixel's step.
  for (int g = 0; g < n_groups(); ++g) {
    const auto column_at = [&](int position) {
      return column_of[count(order_[count(position)])];
    };
    int first_wanted = group_begin(g);
    while (first_wanted < group_end(g) && column_at(first_wanted) < 0) {
      ++first_wanted;
    }
    if (first_wanted == group_end(g)) {
      continue;
    }
    const SparseBlock block = sparse(i_tile, channel, g);
    std::size_t e = 0;
    std::size_t first = 0;  // cell of this position
    for (int position = group_begin(g); position < group_end(g); ++position) {  // cells ascend
      const int column = column_at(position);
      for (; e < block.cell.size() && block.cell[e] < first + n_pixels; ++e) {
        if (column >= 0) {
          const std::size_t p = block.cell[e] - first;
          out[p * n_columns + count(column)] = static_cast<float>(steps[p] * block.value[e]);
        }
      }
      first += n_pixels;
    }
  }
  return out;
}

std::vector<float> BasisFile::decode_tile(int i_tile, int channel) const {
  if (header_.coding == BasisCoding::integers) {
    return decode_integers_of(i_tile, channel);
  }
  const std::size_t n_pixels = count(tile_rect(i_tile).n_pixels());
  const std::size_t n_lights = count(header_.dims.n_lights);
  if (header_.coding == BasisCoding::lossless) {
    std::vector<float> out(n_pixels * n_lights);
    for (int g = 0; g < n_groups(); ++g) {
      put_lights(floats(i_tile, channel, g), n_pixels, n_lights,
                 out.data() + count(group_begin(g)));
    }
    return out;
  }
  const PixelBlock pixel_block = pixels(i_tile, channel);
  std::vector<int> all(n_lights);
  std::iota(all.begin(), all.end(), 0);
  std::vector<float> out = coefficients_of(i_tile, channel, pixel_block, all, n_lights);
  const std::vector<double> terms = plate_terms(tile_rect(i_tile), header_.plate_degree);
  std::vector<double> row(n_lights);
  PlateShare plate(header_.gain_step, pixel_block, terms, tables_.plate_vectors, n_lights);
  for (std::size_t p = 0; p < n_pixels; ++p) {
    const std::span<float> values = std::span(out).subspan(p * n_lights, n_lights);
    std::copy(values.begin(), values.end(), row.begin());
    basis_->inverse(std::span(row));
    plate.add(p, row);
    std::transform(row.begin(), row.end(), values.begin(),
                   [](double v) { return static_cast<float>(v); });
  }
  return out;
}

std::vector<float> BasisFile::decode_lights(int i_tile, int channel,
                                            std::span<const int> lights) const {
  const std::size_t n_pixels = count(tile_rect(i_tile).n_pixels());
  const std::size_t n_lights = count(header_.dims.n_lights);
  const std::size_t n_wanted = lights.size();
  HAARLIGHT_EXPECTS(std::ranges::all_of(
                        lights, [this](int k) { return k >= 0 && k < header_.dims.n_lights; }),
                    "lights of the file");
  std::vector<float> out(n_pixels * n_wanted);
  if (header_.coding != BasisCoding::quantised) {
    pick_columns(decode_tile(i_tile, channel), n_lights, lights, out);
    return out;
  }
  // Coefficients in which some of the lights are: the others add nothing to them.
  std::vector<double> row(n_lights);
  std::vector<int> column_of(n_lights, -1);
  std::vector<std::size_t> columns;
  for (const int k : lights) {
    std::ranges::fill(row, 0.0);
    row[count(k)] = 1.0;
    basis_->forward(std::span(row));
    for (std::size_t i = 0; i < n_lights; ++i) {
      if (row[i] != 0.0 && column_of[i] < 0) {
        column_of[i] = static_cast<int>(columns.size());
        columns.push_back(i);
      }
    }
  }
  const PixelBlock pixel_block = pixels(i_tile, channel);
  const std::vector<float> coefficients =
      coefficients_of(i_tile, channel, pixel_block, column_of, columns.size());
  const std::vector<double> terms = plate_terms(tile_rect(i_tile), header_.plate_degree);
  std::vector<float> vectors(count(header_.plate_rank) * n_wanted);
  pick_columns(tables_.plate_vectors, n_lights, lights, vectors);
  std::ranges::fill(row, 0.0);
  std::vector<double> values(n_wanted);
  PlateShare plate(header_.gain_step, pixel_block, terms, vectors, n_wanted);
  for (std::size_t p = 0; p < n_pixels; ++p) {
    for (std::size_t i = 0; i < columns.size(); ++i) {
      row[columns[i]] = coefficients[p * columns.size() + i];
    }
    basis_->inverse_at(row, lights, values);
    plate.add(p, values);
    std::transform(values.begin(), values.end(),
                   out.begin() + static_cast<std::ptrdiff_t>(p * n_wanted),
                   [](double v) { return static_cast<float>(v); });
  }
  return out;
}

namespace {

/// @param decode  (tile, channel) to (pixels, n_values)
void read_from_tiles(const BasisFile& file, const TileRect& rect, std::size_t n_values,
                     const std::function<std::vector<float>(int, int)>& decode,
                     std::span<float> out) {
  const int n_channels = file.header().dims.channels;
  HAARLIGHT_EXPECTS(out.size() == count(n_channels) * count(rect.n_pixels()) * n_values,
                    "room for the tile's values");
  for (const int t : file.tiles_of(rect)) {
    const TileRect tile = file.tile_rect(t);
    const int x0 = std::max(rect.x0, tile.x0);
    const int y0 = std::max(rect.y0, tile.y0);
    const int x1 = std::min(rect.x0 + rect.width, tile.x0 + tile.width);
    const int y1 = std::min(rect.y0 + rect.height, tile.y0 + tile.height);
    for (int c = 0; c < n_channels; ++c) {
      const std::vector<float> values = decode(t, c);
      for (int y = y0; y < y1; ++y) {
        const std::size_t from = count((y - tile.y0) * tile.width + x0 - tile.x0) * n_values;
        const std::size_t to = (count(c) * count(rect.n_pixels()) +
                                count((y - rect.y0) * rect.width + x0 - rect.x0)) *
                               n_values;
        std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(from),
                    count(x1 - x0) * n_values, out.begin() + static_cast<std::ptrdiff_t>(to));
      }
    }
  }
}

}  // namespace

void BasisSource::read_tile(const TileRect& rect, std::span<float> out) const {
  read_from_tiles(
      file_, rect, count(file_.header().dims.n_lights),
      [this](int tile, int channel) { return file_.decode_tile(tile, channel); }, out);
}

void BasisSource::read_lights(const TileRect& rect, std::span<const int> lights,
                              std::span<float> out) const {
  read_from_tiles(
      file_, rect, lights.size(),
      [&](int tile, int channel) { return file_.decode_lights(tile, channel, lights); }, out);
}

BasisWriter::BasisWriter(const std::filesystem::path& file) : file_(file) {
  const std::array<std::byte, kPreambleBytes> empty{};
  file_.append(empty);
}

void BasisWriter::append_block(const PackedTile::Block& block) {
  HAARLIGHT_EXPECTS(block.bytes.size() <= std::numeric_limits<std::uint32_t>::max(),
                    "a block below 4 GB");
  index_.push_back({file_.size(), block_checksum(block.bytes),
                    static_cast<std::uint32_t>(block.bytes.size()), block.n_entries});
  file_.append(block.bytes);
}

void BasisWriter::append(const PackedTile& tile) {
  append_block(tile.pixels);
  for (const PackedTile::Block& block : tile.groups) {
    append_block(block);
  }
}

void BasisWriter::append_section(const std::string& name, std::span<const float> values,
                                 BasisHeader& header) {
  const std::vector<std::byte> bytes = encode_floats(values, values.size());
  header.sections.push_back(
      {name, file_.size(), bytes.size(), block_checksum(bytes), values.size()});
  file_.append(bytes);
}

std::uint64_t BasisWriter::finish(const BasisHeader& given, const BasisTables& tables) {
  BasisHeader header = given;
  header.sections.clear();
  if (!tables.coded_bound.is_empty()) {
    append_section(std::string(kCodedBoundSection), picture_bound_to_floats(tables.coded_bound),
                   header);
  }
  if (!tables.term_bound.is_empty()) {
    append_section(std::string(kTermBoundSection), picture_bound_to_floats(tables.term_bound),
                   header);
  }
  if (!tables.clipped_counts.empty()) {
    std::vector<float> clipped = tables.clipped_counts;
    clipped.insert(clipped.end(), tables.clipped_norms.begin(), tables.clipped_norms.end());
    append_section(std::string(kClippedSection), clipped, header);
  }
  Preamble preamble;
  const auto add_part = [this](std::span<const std::byte> bytes) {
    const std::array<std::uint64_t, 3> part = {file_.size(), bytes.size(),
                                               block_checksum(bytes)};
    file_.append(bytes);
    return part;
  };
  const std::vector<float> table = tables_to_floats(tables);
  HAARLIGHT_EXPECTS(table.size() == table_values(header), "tables of the header's shape");
  preamble.tables = add_part(encode_floats(table, table.size()));
  std::vector<std::byte> index(index_.size() * kEntryBytes);
  for (std::size_t i = 0; i < index_.size(); ++i) {
    std::byte* to = index.data() + i * kEntryBytes;
    put(to, index_[i].offset);
    put(to + 8, index_[i].checksum);
    put(to + 16, index_[i].bytes);
    put(to + 20, index_[i].n_entries);
  }
  preamble.index = add_part(index);
  const std::string json = basis_header_to_json(header);
  preamble.header = add_part(std::as_bytes(std::span(json.data(), json.size())));
  preamble.file_bytes = file_.size();
  file_.rewrite(0, to_bytes(preamble));
  file_.commit();
  return preamble.file_bytes;
}

}  // namespace haarlight::relight
