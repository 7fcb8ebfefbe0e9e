// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/basis_file.h"
#include "relight/basis/coder/quantiser.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/plate/plate.h"

/// @file
/// What compress does with one tile: subtract the clean plate, transform, quantise, measure,
/// pack. A tile's bytes and sums depend only on its values and the header, so tiles may be
/// coded in any order, by any thread or process. Method: docs/numerics/relight.md, "The coder".

namespace haarlight::relight {

/// What all tiles of a file share.
struct TileCoding {
  BasisHeader header;  ///< dims, basis, coding, steps, plate, group_ends, dark_norm
  std::shared_ptr<const FixedBasis> basis;  ///< make_basis(header)
  PlateVectors vectors;                     ///< rank 0: no plate
  const StackSource* plate = nullptr;
  double worst_pixel = std::numeric_limits<double>::infinity();
  bool has_term_products = false;
  BlockContent content = BlockContent::repeats;  ///< of the coefficients' blocks
  std::string source;                            ///< named in errors
};

/// The clean plate as a pass over a tile found it: the next pass need not search again.
struct TilePlateFit {
  std::vector<float> plates;  ///< (channels, fit_tile_plate()); empty: there is no plate
  std::vector<double> gains;  ///< (channels, pixels), before any step: of the pixels looked at
  bool is_in_floats = false;  ///< the gains were found in floats
  [[nodiscard]] std::size_t bytes() const {
    return plates.size() * sizeof(float) + gains.size() * sizeof(double);
  }
};

/// Sums over the pixels of a tile, (channels, n_lights) each; they add up over tiles.
struct TileSums {
  std::vector<double> light_energy;        ///< of T_k
  std::vector<double> light_error;         ///< of decoded_k - T_k
  std::vector<double> coefficient_energy;  ///< of the stored residual
  std::vector<double> coefficient_error;   ///< of decoded - true coefficients
  std::vector<double> clipped;             ///< counts of values clipped in every exposure
  std::vector<double> clipped_energy;      ///< their energy: a lower bound
  std::vector<double> gram_rests;  ///< (channels): TileErrors::largest_rest(), as a value
  double peak = 0.0;               ///< largest absolute value of the light transport matrix T
  double worst_pixel = 0.0;        ///< StackError::worst_pixel
  double worst_value = 0.0;        ///< largest |decoded - T|
  double n_coefficients = 0.0;

  TileSums() = default;
  explicit TileSums(const StackDims& dims);
  void add(const TileSums& other);
  [[nodiscard]] std::vector<double> to_numbers() const;
  /// @return  false if the number of values differs from that of to_numbers()
  [[nodiscard]] bool set_numbers(std::span<const double> numbers);
};

struct CodedTile {
  std::vector<PackedTile> channels;
  TileSums sums;
  /// (channels, gram_size(n_lights)) for quantised files: products of the coefficients' errors
  /// in units of gram_scale(header)^2.
  std::vector<std::int32_t> error_products;
  /// The same of the stored coefficients themselves, in units of term_unit(header)^2; empty
  /// unless TileCoding::has_term_products.
  std::vector<float> term_products;
};

/// The unit of whole steps for TileErrors: no error is larger than kGramLargest of them.
[[nodiscard]] double gram_scale(const BasisHeader& header);

/// The unit of coefficients in CodedTile::term_products: the power of two at or below the step.
/// Products of coefficients in the stack's units would leave the floats' range from 1e19 and
/// below 1e-19; a power of two changes no other bit.
[[nodiscard]] double term_unit(const BasisHeader& header);

/// Codes one tile. Values are float where the requested error is 1e-4 or more and
/// the step 1e-34 or more, else double.
/// @param values   (channels, rect.height, rect.width, n_lights)
/// @param clipped  the same shape: nonzero where a value is a lower bound; empty: none is
/// @param known    StackSample::fit of this tile, if it was kept; the result is the same
/// @throws Error  NaN or infinity: names light and pixel
[[nodiscard]] CodedTile code_tile(const TileCoding& coding, const TileRect& rect,
                                  std::span<const float> values,
                                  std::span<const std::uint8_t> clipped = {},
                                  const TilePlateFit* known = nullptr);

/// What the steps are chosen from: a sample of the stack, before any step is known.
struct StackSample {
  double energy = 0.0;
  double peak = 0.0;
  double n_rows = 0.0;           ///< pixels times channels
  MagnitudeHistogram residuals;  ///< magnitudes of the residual's coefficients
  TilePlateFit fit;              ///< of a tile's pixels; merge() drops it
  void merge(const StackSample& other);
};

/// @param rect    pixels of one tile: part of it, or all
/// @param values  (channels, rect.height, rect.width, n_lights)
[[nodiscard]] StackSample sample_pixels(const TileCoding& coding, const TileRect& rect,
                                        std::span<const float> values);

}  // namespace haarlight::relight
