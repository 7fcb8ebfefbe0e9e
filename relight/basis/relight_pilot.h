// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/basis/light_query.h"

/// @file
/// What pictures of a basis file cost on this processor, measured on a few of its tiles: CPU
/// seconds of unpacking each group of coefficients, of the products of a term, of the rest. What
/// a picture of K terms costs follows by counting bytes and products. Method:
/// docs/numerics/relight.md, "Seconds". One thread.

namespace haarlight::relight {

/// CPU seconds of one pass over the whole file that makes some pictures (relight()).
struct FilePassCost {
  int n_groups = 0;
  std::vector<double> unpack;  ///< (channels, groups): reading and unpacking the blocks
  std::vector<double> term;    ///< (channels, n_lights): products of a term and colour
  double pixels = 0.0;         ///< reading what every pixel has besides coefficients
  double picture = 0.0;        ///< of one colour of a picture: clean plate, writing
  double reading = 0.0;        ///< all that was needed of the file, for any number of pictures
  double summing = 0.0;        ///< the pictures of the pilot beside that, all together
};

/// The same of a quantised file in memory (prepared_basis.h).
struct MemoryCost {
  double unpack = 0.0;       ///< once
  std::vector<double> rows;  ///< (channels): one colour of a picture, all coefficients
  std::vector<double> term;  ///< (channels, n_lights): the list of one term and colour
};

struct FilePilot {
  FilePassCost cost;
  /// (environments): an estimate of the norm of the picture of all terms, less twice its standard
  /// error; half the estimate at least, and of one tile.
  std::vector<double> norms;
};

/// Tiles spread over the picture: one in 32, 4 to 64; of small files one in 16.
[[nodiscard]] std::vector<int> pilot_tiles(const BasisFile& basis);

/// What pilot_file() sums of a picture's tiles, as a part of all: two sums of its tiles.
[[nodiscard]] double pilot_share(const BasisFile& basis, std::span<const int> tiles);

/// Sums the pictures of all terms on some tiles, twice, and scales what each part took by
/// the bytes and pixels of the file.
/// @throws Error  as relight()
[[nodiscard]] FilePilot pilot_file(const BasisFile& basis,
                                   std::span<const LightWeights> weights,
                                   std::span<const int> tiles);

/// Unpacks some tiles of a quantised file and sums them by rows and by lists.
/// @param n_pictures  that are made at once
[[nodiscard]] MemoryCost pilot_memory(const BasisFile& basis, int n_pictures,
                                      std::span<const int> tiles);

/// The same of an exact file as half floats (dense_half.h).
struct HalfCost {
  double store = 0.0;    ///< once
  double picture = 0.0;  ///< one picture
  double error = 0.0;    ///< the relative bound that half floats add, the largest of `weights`
};

/// Stores one tile as half floats and sums the pictures of that tile.
[[nodiscard]] HalfCost pilot_half(const BasisFile& basis, std::span<const LightWeights> weights,
                                  int tile);

/// CPU seconds of one picture from the file, by its number of terms: entry K is that of the first
/// K of every colour; ascends; one entry more than the most terms of a colour.
/// @param shared_by  pictures that are summed in the same pass
[[nodiscard]] std::vector<double> file_seconds_by_terms(const BasisFile& basis,
                                                        const FilePassCost& cost,
                                                        LightQueries& queries, int environment,
                                                        TermOrder order, double shared_by);
/// The same from memory, without MemoryCost::unpack.
/// @param picture  seconds of a colour besides its coefficients
[[nodiscard]] std::vector<double> memory_seconds_by_terms(const MemoryCost& cost,
                                                          double picture, LightQueries& queries,
                                                          int environment, TermOrder order);

}  // namespace haarlight::relight
