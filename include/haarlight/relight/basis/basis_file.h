// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/files.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/picture_facts.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/coder/block_codec.h"
#include "haarlight/relight/basis/haar.h"

/// @file
/// The basis file `.hlb`: a light stack compressed over its lights, self-contained (with rig,
/// clean plate and norms), with random access by tile. Every byte is specified in
/// docs/reference/basis-format.md; docs/reference/read_hlb.py reads it with NumPy.

namespace haarlight::relight {

inline constexpr std::uint32_t kBasisVersion = 3;
inline constexpr std::uint32_t kOldestBasisVersion = 2;  ///< the oldest that can still be read

enum class BasisKind {
  haar,           ///< 2-D Haar over each grid of lights (haar.h)
  direct,         ///< the lights themselves; needs no grid
  haar_standard,  ///< Haar along each row of a grid, then along each column
  dct,            ///< 2-D DCT-II of each grid
};
inline constexpr auto kBasisKindWords =
    std::to_array<std::string_view>({"haar", "direct", "haar-standard", "dct"});
constexpr std::span<const std::string_view> words_of(BasisKind) { return kBasisKindWords; }
enum class BasisCoding {
  quantised,  ///< multiples of a step, with the achieved error
  lossless,   ///< the stack's floats bit for bit, light by light
  integers,   ///< integer multiples of each light's unit, all exact
};
inline constexpr auto kBasisCodingWords =
    std::to_array<std::string_view>({"quantised", "lossless", "integers"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(BasisCoding) noexcept {
  return kBasisCodingWords;
}

/// What a basis file's values are.
enum class BasisContent { capture, plate };
inline constexpr auto kBasisContentWords =
    std::to_array<std::string_view>({"capture", "plate"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(BasisContent) noexcept {
  return kBasisContentWords;
}

/// Where the clean plate came from that was taken off.
enum class PlateOrigin {
  none,
  computed,  ///< from the rig
  captured,  ///< a session of the empty rig
};
inline constexpr auto kPlateOriginWords =
    std::to_array<std::string_view>({"none", "computed", "captured"});
[[nodiscard]] constexpr std::span<const std::string_view> words_of(PlateOrigin) noexcept {
  return kPlateOriginWords;
}

/// A light of a capture without a rig file.
struct BasisLight {
  std::string name;
  bool is_position = false;
  Eigen::Vector3d coordinates =
      Eigen::Vector3d::Zero();  ///< mm in world, or unit direction to it
  double relative_power = 1.0;
};

/// The decoded stack's error against the one that was compressed: T, the light transport
/// matrix.
struct StackError {
  double relative_l2 = 0.0;  ///< ||decoded - T|| / ||T|| over the whole stack
  /// Largest ||decoded_p - T_p|| / max(||T_p||, dark_norm) of a pixel's row over the lights.
  double worst_pixel = 0.0;
  double worst_value = 0.0;  ///< largest |decoded - T| of one value / largest |T|
};

/// Values that were clipped in every exposure: lower bounds of the light, not covered by any
/// error that a file or a picture states.
struct ClippedValues {
  double n_values = 0.0;  ///< of pixels x channels x lights
  /// Their norm as stored, as a fraction of the stack's norm ||T||: a lower bound on their part
  /// of the stack.
  double least_norm = 0.0;
  [[nodiscard]] double fraction(const StackDims& dims) const {
    return n_values / (double(dims.n_pixels()) * dims.channels * dims.n_lights);
  }
};

/// A part of the file other than blocks, index and tables; a reader skips those it does not
/// know.
struct BasisSection {
  std::string name;
  std::uint64_t offset = 0;
  std::uint64_t bytes = 0;
  std::uint64_t checksum = 0;
  std::uint64_t n_values = 0;  ///< floats, coded as the tables are
};

/// The header of a basis file.
struct BasisHeader {
  StackDims dims;
  int tile = 32;  ///< pixels per side; tiles at the right and lower edge are smaller
  BasisKind basis = BasisKind::haar;
  BasisCoding coding = BasisCoding::quantised;
  HaarGrid grid;           ///< of each face, in order; 0 x 0 where there is none
  double step = 0.0;       ///< quantiser step before a pixel's shift
  double dead_zone = 0.0;  ///< |c| below dead_zone * step became 0
  double dark_norm = 0.0;  ///< see StackError::worst_pixel; 1 % of the rms pixel norm
  PlateOrigin plate = PlateOrigin::none;
  std::string plate_source;  ///< hash of what the clean plate came from
  int plate_rank = 0;
  int plate_degree = 0;         ///< of the polynomials of each tile (tile_plate.h)
  double gain_step = 0.0;       ///< a pixel's gain is a multiple of it
  std::vector<double> units;    ///< (n_lights) of BasisCoding::integers, else empty
  std::vector<int> group_ends;  ///< last + 1 of each group, in order; the last is n_lights

  std::string rig_toml;  ///< empty: see lights
  std::string rig_hash;
  std::vector<BasisLight> lights;

  double requested_relative_l2 = 0.0;
  double requested_worst_pixel = 0.0;  ///< infinity: no limit
  StackError achieved;
  std::optional<ClippedValues> clipped;  ///< none: unknown (version 2, no frames)
  double stack_norm = 0.0;               ///< ||T||, of the light transport matrix
  double peak = 0.0;               ///< largest absolute value of the light transport matrix
  double mean_coefficients = 0.0;  ///< stored coefficients per pixel and channel
  std::string source;              ///< session id or file name
  std::string source_hash;         ///< of the plan, where there is one
  std::string source_root;         ///< of the session, where it has one
  PictureFacts photographed;       ///< of an imported session
  BasisContent content = BasisContent::capture;
  std::string program;
  std::vector<BasisSection> sections;  ///< as read; the writer's own

  [[nodiscard]] int n_grids() const {
    return grid.size() > 0 ? dims.n_lights / grid.size() : 0;
  }
  /// Numbers per tile's clean plate: rank (degree + 1)^2.
  [[nodiscard]] int n_plate() const {
    return plate_rank * (plate_degree + 1) * (plate_degree + 1);
  }
};

/// Bounds ||sum_i l_i P_i|| for pictures of norms p_i, channel by channel: the sum, over blocks
/// of kGramBlock neighbours in coefficient order, of
///     sqrt(sum_j (v_j . x)^2 + fraction ||x||^2) + rest sum_i |l_i|,   x_i = p_i l_i.
/// Method: docs/numerics/relight.md, "The coding error's bound".
struct PictureBound {
  int n_vectors = 0;
  std::vector<float> fractions;  ///< (channels, blocks); empty: no bound is stored
  std::vector<float> rests;      ///< (channels, blocks)
  std::vector<float>
      vectors;  ///< (channels, n_vectors, n_lights), in the order of coefficients
  [[nodiscard]] bool is_empty() const noexcept { return fractions.empty(); }
};

/// Tables over lights and coefficients, rounded upwards to float where they bound something.
struct BasisTables {
  std::vector<float> plate_vectors;      ///< (plate_rank, n_lights)
  std::vector<float> coefficient_norms;  ///< (channels, n_lights): of the stored residual
  std::vector<float>
      coefficient_errors;           ///< (channels, n_lights): of decoded - true coefficients
  std::vector<float> light_norms;   ///< (channels, n_lights): ||T_k||
  std::vector<float> light_errors;  ///< (channels, n_lights): ||decoded_k - T_k||
  PictureBound coded_bound;         ///< of decoded - true coefficients; of quantised files
  PictureBound term_bound;          ///< of the stored residual; where that has few coefficients
  /// (channels, n_lights): values that were clipped, and their norm as stored; empty: none
  std::vector<float> clipped_counts;
  std::vector<float> clipped_norms;
};

/// The order in which coefficients are stored: order[i] is a light-domain index (row * n + col
/// within its grid, grids one after the other). The index itself where nothing is quantised or
/// the basis is direct.
[[nodiscard]] std::vector<int> coefficient_order(const BasisHeader& header);
/// The default groups: per grid the coarse coefficients of 8 per side, then one group per
/// level; 64 lights where the order is the lights' own.
[[nodiscard]] std::vector<int> default_group_ends(const BasisHeader& header);

class FixedBasis;

/// One block of the index.
struct BlockEntry {
  std::uint64_t offset = 0;
  std::uint64_t checksum = 0;
  std::uint32_t bytes = 0;
  std::uint32_t n_entries = 0;
};

/// An open basis file, mapped. Const calls are thread-safe.
class BasisFile {
 public:
  /// Checks everything except the blocks, which are checked when read.
  /// @throws Error  not a basis file, newer version, truncated, damaged
  [[nodiscard]] static BasisFile open(const std::filesystem::path& file);
  /// The same from bytes in memory (fuzzing); `bytes` must outlive the object.
  [[nodiscard]] static BasisFile from_bytes(std::span<const std::byte> bytes,
                                            const std::string& name);

  [[nodiscard]] const BasisHeader& header() const noexcept { return header_; }
  [[nodiscard]] const BasisTables& tables() const noexcept { return tables_; }
  [[nodiscard]] const FixedBasis& basis() const noexcept { return *basis_; }
  [[nodiscard]] const std::string& name() const noexcept { return name_; }
  [[nodiscard]] std::uint64_t n_bytes() const noexcept { return bytes_.size(); }
  /// Hash of the whole content: over the checksums of all parts, block by block.
  [[nodiscard]] std::string content_key() const;

  [[nodiscard]] int n_tiles() const noexcept { return tiles_x_ * tiles_y_; }
  [[nodiscard]] int n_groups() const { return static_cast<int>(header_.group_ends.size()); }
  [[nodiscard]] TileRect tile_rect(int i_tile) const;
  /// Tiles that overlap a part of the picture, in order.
  [[nodiscard]] std::vector<int> tiles_of(const TileRect& rect) const;
  /// order()[i] as coefficient_order() defines it.
  [[nodiscard]] const std::vector<int>& order() const noexcept { return order_; }
  [[nodiscard]] int group_begin(int group) const {
    return group == 0 ? 0 : header_.group_ends[static_cast<std::size_t>(group) - 1];
  }
  [[nodiscard]] int group_end(int group) const {
    return header_.group_ends[static_cast<std::size_t>(group)];
  }

  [[nodiscard]] PixelBlock pixels(int i_tile, int channel) const;
  /// @param group  of a quantised file
  [[nodiscard]] SparseBlock sparse(int i_tile, int channel, int group) const;
  [[nodiscard]] bool is_group_empty(int i_tile, int channel, int group) const;
  [[nodiscard]] std::uint32_t group_bytes(int i_tile, int channel, int group) const;
  /// (lights of the group, pixels), for files that are not quantised. With integers, every
  /// group costs the whole tile.
  [[nodiscard]] std::vector<float> floats(int i_tile, int channel, int group) const;

  /// A tile's values (pixels, n_lights), decoded.
  [[nodiscard]] std::vector<float> decode_tile(int i_tile, int channel) const;
  /// The same of some lights, (pixels, lights.size()): the same bits.
  [[nodiscard]] std::vector<float> decode_lights(int i_tile, int channel,
                                                 std::span<const int> lights) const;

 private:
  BasisFile() = default;
  void parse();
  void read_sections();
  /// A quantised tile's coefficients times their steps, (pixels, n_columns).
  /// @param column_of  by light-domain index where it is wanted; -1: it is not
  [[nodiscard]] std::vector<float> coefficients_of(int i_tile, int channel,
                                                   const PixelBlock& pixel_block,
                                                   std::span<const int> column_of,
                                                   std::size_t n_columns) const;
  /// (pixels, n_lights)
  [[nodiscard]] std::vector<float> decode_integers_of(int i_tile, int channel) const;
  [[nodiscard]] const BlockEntry& entry(int i_tile, int channel, int block) const;
  [[nodiscard]] std::span<const std::byte> block_bytes(int i_tile, int channel,
                                                       int block) const;
  [[nodiscard]] std::string block_name(int i_tile, int channel, int block) const;

  MappedFile mapping_;
  std::span<const std::byte> bytes_;
  std::string name_;
  BasisHeader header_;
  std::shared_ptr<const FixedBasis> basis_;
  BasisTables tables_;
  std::vector<BlockEntry> index_;
  std::vector<int> order_;
  int tiles_x_ = 0;
  int tiles_y_ = 0;
};

/// A basis file as a light stack. Borrows it.
class BasisSource final : public StackSource {
 public:
  explicit BasisSource(const BasisFile& file) : file_(file) {}
  [[nodiscard]] StackDims dims() const override { return file_.header().dims; }
  void read_tile(const TileRect& rect, std::span<float> out) const override;
  void read_lights(const TileRect& rect, std::span<const int> lights,
                   std::span<float> out) const override;

 private:
  const BasisFile& file_;
};

/// The blocks of one tile and channel, packed.
struct PackedTile {
  struct Block {
    std::vector<std::byte> bytes;
    std::uint32_t n_entries = 0;
  };
  Block pixels;
  std::vector<Block> groups;
};

/// Writes a basis file tile by tile; it appears in finish(). One thread.
class BasisWriter {
 public:
  explicit BasisWriter(const std::filesystem::path& file);
  /// Tiles in order, channels of a tile in order.
  void append(const PackedTile& tile);
  /// @return  bytes of the file
  std::uint64_t finish(const BasisHeader& header, const BasisTables& tables);

 private:
  void append_block(const PackedTile::Block& block);
  void append_section(const std::string& name, std::span<const float> values,
                      BasisHeader& header);

  PendingFile file_;
  std::vector<BlockEntry> index_;
};

}  // namespace haarlight::relight
