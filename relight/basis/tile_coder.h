#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "relight/basis/basis_file.h"
#include "relight/basis/plate.h"
#include "relight/basis/quantiser.h"
#include "relight/basis/stack_source.h"

/// @file
/// What compress does with one tile: plate off, transform, quantise, measure, pack. A tile's
/// bytes and sums depend on its values and on the header alone, so that tiles may be coded in
/// any order, by any thread or process. Method: docs/numerics/relight.md, "The coder".

namespace haarlight {

/// What all tiles of a file share.
struct TileCoding {
  BasisHeader header;    ///< dims, basis, coding, steps, plate, group_ends, dark_norm
  PlateVectors vectors;  ///< rank 0: no plate
  const StackSource* plate = nullptr;
  double worst_pixel = std::numeric_limits<double>::infinity();
  std::string source;  ///< named in errors
};

/// Sums over the pixels of a tile, (channels, n_lights) each; they add up over tiles.
struct TileSums {
  std::vector<double> light_energy;        ///< of T_k
  std::vector<double> light_error;         ///< of decoded_k - T_k
  std::vector<double> coefficient_energy;  ///< of the stored residual
  std::vector<double> coefficient_error;   ///< of decoded - true coefficients
  double peak = 0.0;                       ///< largest |T|
  double worst_pixel = 0.0;                ///< StackError::worst_pixel
  double worst_value = 0.0;                ///< largest |decoded - T|
  double n_coefficients = 0.0;

  TileSums() = default;
  explicit TileSums(const StackDims& dims);
  void add(const TileSums& other);
  [[nodiscard]] std::vector<double> to_numbers() const;
  /// @return  false where the numbers are not as many as to_numbers() gives
  [[nodiscard]] bool set_numbers(std::span<const double> numbers);
};

struct CodedTile {
  std::vector<PackedTile> channels;
  TileSums sums;
};

/// Codes one tile. Values are float where the error asked for is 1e-4 or more, else double.
/// @param values  (channels, rect.height, rect.width, n_lights)
/// @throws Error  NaN or infinity: names light and pixel
[[nodiscard]] CodedTile code_tile(const TileCoding& coding, const TileRect& rect,
                                  std::span<const float> values);

/// What the steps are chosen from: a part of the stack, before any step is known.
struct StackSample {
  double energy = 0.0;
  double peak = 0.0;
  double n_rows = 0.0;           ///< pixels times channels
  MagnitudeHistogram residuals;  ///< magnitudes of the residual's coefficients
  void merge(const StackSample& other);
};

/// @param rect    pixels of one tile: a part of it, or all
/// @param values  (channels, rect.height, rect.width, n_lights)
[[nodiscard]] StackSample sample_pixels(const TileCoding& coding, const TileRect& rect,
                                        std::span<const float> values);

}  // namespace haarlight
