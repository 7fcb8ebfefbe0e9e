// SPDX-License-Identifier: Apache-2.0
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <memory_resource>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/coder/sparse_tile.h"
#include "relight/basis/dense_half.h"
#include "relight/basis/huge_page_buffer.h"
#include "relight/basis/relight_kernels.h"

/// @file
/// A basis file unpacked into memory, for repeated relighting: animations, a server. Sums are
/// float, in an order fixed by the data: the same bits for any number of threads, for an
/// environment alone or in a batch, by rows or by lists. Their rounding is part of the bound.
/// Method, selection rule and figures: docs/numerics/relight.md, "Kernels".

namespace haarlight::relight {

enum class PreparedForm {
  automatic,  ///< sparse, unless the file is lossless or has too many coefficients per pixel
  sparse,     ///< rows and lists of the stored coefficients; quantised files
  dense,      ///< every light of every pixel as half floats; any file, no choice of terms
};

/// How a picture is summed.
enum class RelightMethod {
  dense_half,         ///< all lights of all pixels
  sparse_rows,        ///< all coefficients, pixel by pixel
  coefficient_lists,  ///< only the coefficients that the light has
};
inline constexpr auto kRelightMethodWords =
    std::to_array<std::string_view>({"dense half", "sparse rows", "coefficient lists"});
constexpr std::span<const std::string_view> words_of(RelightMethod) {
  return kRelightMethodWords;
}

struct PrepareOptions {
  PreparedForm form = PreparedForm::automatic;
  /// Number of coefficient products that may be spent on the sharper bound on dropped terms,
  /// about one second per billion on one core; beyond it the triangle inequality is used.
  double bound_products = 4e9;
  std::uint64_t memory_bytes = std::uint64_t{4} << 30U;
};

struct PreparedRun {
  /// None: the faster one, by the number of coefficients of the light.
  std::optional<RelightMethod> method;
  KernelCode code = best_kernel_code();
  std::vector<RelitPicture> reuse;  ///< of an earlier call, whose memory is reused
};

/// Const calls are thread-safe.
class PreparedBasis {
 public:
  /// The file is not needed afterwards.
  /// @throws Error  damaged blocks; the sparse form of a lossless file, or of more than 32 768
  ///                lights; more memory than allowed
  explicit PreparedBasis(const BasisFile& basis, const PrepareOptions& options = {});

  /// Whether the sparse form of a file exists and takes no more memory than that.
  [[nodiscard]] static bool can_hold(const BasisFile& basis, std::uint64_t memory_bytes);

  [[nodiscard]] const BasisHeader& header() const noexcept { return header_; }
  /// The form in use: `automatic`, resolved.
  [[nodiscard]] PreparedForm form() const noexcept {
    return dense_ ? PreparedForm::dense : PreparedForm::sparse;
  }
  [[nodiscard]] std::uint64_t bytes() const noexcept { return bytes_; }
  [[nodiscard]] bool has_sharp_bound() const noexcept { return !products_.empty(); }

  /// As relight() does, from memory; RelitPicture::method names what was chosen.
  /// @throws Error  weights with a wrong number of lights; RelightOptions::terms with the dense
  ///                form, which has no terms
  [[nodiscard]] std::vector<RelitPicture> relight(std::span<const LightWeights> weights,
                                                  const RelightOptions& options = {},
                                                  PreparedRun run = {}) const;

 private:
  struct Chunk;

  void unpack(const BasisFile& basis, std::uint64_t memory_bytes);
  void add_plate_squares(const SparseTile& tile, const TileRect& rect,
                         std::span<double> squares) const;
  void measure_products(double most);
  [[nodiscard]] std::vector<double> grid_products(int channel, std::size_t grid,
                                                  std::size_t per_grid) const;
  [[nodiscard]] std::vector<double> sharper_tails(const LightQuery& query,
                                                  std::span<const int> ranked) const;
  [[nodiscard]] std::vector<RelitPicture> relight_dense(std::span<const LightWeights> weights,
                                                        const RelightOptions& options,
                                                        PreparedRun run) const;
  [[nodiscard]] std::vector<RelitPicture> sum(const LightQueries& requested,
                                              PreparedRun& run) const;
  [[nodiscard]] Chunk make_chunk(std::vector<const LightQuery*> queries,
                                 std::optional<RelightMethod> method) const;
  [[nodiscard]] std::vector<double> factors_of(const LightQuery& query) const;
  [[nodiscard]] double rounding(const LightQuery& query, int exponent) const;
  std::uint64_t sum_tile(std::size_t i_tile, int channel, const Chunk& chunk, KernelCode code,
                         std::vector<RelitPicture>& pictures) const;
  [[nodiscard]] const SparseTile& tile(std::size_t i_tile, int channel) const;

  std::string name_;
  BasisHeader header_;
  BasisTables tables_;
  std::uint64_t bytes_ = 0;
  std::optional<DenseHalf> dense_;
  std::vector<TileRect> rects_;
  /// Memory that the tiles live in, several tiles each.
  struct Memory {
    explicit Memory(std::uint64_t bytes);
    HugePageBuffer buffer;
    std::unique_ptr<std::pmr::memory_resource> resource;
  };
  std::vector<Memory> memory_;
  std::vector<SparseTile> tiles_;            ///< (tiles, channels)
  std::vector<std::uint64_t> list_lengths_;  ///< (channels, 2 n_lights): entries of all tiles
  std::vector<std::uint64_t> row_entries_;   ///< (channels): including the rows' padding
  std::vector<std::uint32_t> longest_rows_;  ///< (channels): entries of one pixel
  std::vector<double> plate_norms_;          ///< (channels, rank): ||gain u_j||, in gain steps
  std::vector<double> norms_;                ///< (channels, n_lights): ||C_i|| in steps
  /// (channels, grids, n^2, n^2): <C_i, C_j> / (||C_i|| ||C_j||); empty: not measured
  std::vector<float> products_;
};

}  // namespace haarlight::relight
