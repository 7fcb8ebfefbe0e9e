// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"
#include "haarlight/relight/basis/basis_file.h"

/// @file
/// Pictures from a basis file: sum of w_k T_k in the domain of the file. Source: [Ng03], the
/// transport-weighted order of its coefficients. Method and bounds: docs/numerics/relight.md,
/// "Relighting". Sums are double over the lights in a fixed order: results do not depend on the
/// number of threads. Negative values from truncation are kept.

namespace haarlight::relight {

/// Weight of every light, (n_lights, 1 or 3): the same for all channels, or one each.
using LightWeights = Eigen::MatrixXd;

/// The order in which the fast mode adds terms.
enum class TermOrder {
  transport,  ///< by |l_i| * ||T_i||: what a term adds to the picture at most
  light,      ///< by |l_i| alone; leaves 79 % error with nine LEDs and 16 terms: for comparison
};
inline constexpr auto kTermOrderWords = std::to_array<std::string_view>({"transport", "light"});
constexpr std::span<const std::string_view> words_of(TermOrder) { return kTermOrderWords; }

struct RelightOptions {
  std::optional<int> terms;  ///< K largest terms per colour; 0 keeps only the clean plate
  std::optional<double> max_error;  ///< smallest K whose bound on the relative L2 holds
  TermOrder order = TermOrder::transport;
  /// Instead of `terms`, for each picture its own; with max_error, where the search begins and
  /// ends if they keep it (default: predicted by a few tiles; 16 each of PreparedBasis).
  std::vector<int> terms_each;
};

/// Bounds on one channel of a picture.
struct ChannelBound {
  double error =
      0.0;  ///< of its dropped terms and of the coding; RelightBound::rounding comes on top
  double picture_norm = 0.0;
  double relative_l2 = 0.0;  ///< as RelightBound::relative_l2
};

/// Rigorous bounds, from the norms in the file; no ground truth is needed. Per picture. They
/// are relative to the stack that was compressed: what clipped values lack is only in
/// `clipped`.
struct RelightBound {
  /// ||picture - exact picture of the basis file|| <= this: sum of the dropped |l_i| * ||T_i||.
  double dropped = 0.0;
  /// ||exact picture of the file - picture of the uncompressed stack|| <= this.
  double coded = 0.0;
  /// Rounding of sums in float: 0 here, where sums are double; see prepared_basis.h.
  double rounding = 0.0;
  double picture_norm = 0.0;  ///< of the returned picture
  /// e / (picture_norm - e) with e = dropped + coded + rounding; infinity when that is not
  /// positive and 0 for a picture without any light.
  double relative_l2 = 0.0;
  std::vector<ChannelBound> channels;  ///< each channel alone
  /// Not covered by the bounds above: the fraction of the values under the lights in use that
  /// were clipped in every exposure and so are lower bounds; none: unknown to the file.
  std::optional<double> clipped_fraction;
  /// If no clipped value was truly brighter than 1 + f times what the file holds, the picture
  /// of the true light is off by at most another f * clipped: sum |w_k| ||T_k, clipped||.
  double clipped = 0.0;
};

struct RelitPicture {
  Image<float> picture;  ///< linear; channels: the larger of the weights' and the file's
  RelightBound bound;
  int terms = 0;                 ///< terms summed, the largest over the colours
  int terms_all = 0;             ///< terms the exact mode would sum: nonzero l_i with a norm
  std::uint64_t bytes_read = 0;  ///< of blocks
  std::string method = "file";   ///< how it was summed: the file, or a RelightMethod's name
};

/// Exact mode unless an option says otherwise. One pass over the file for all environments.
/// @param weights  one matrix per environment, all finite
/// @throws Error  damaged blocks; weights with a wrong number of lights
[[nodiscard]] std::vector<RelitPicture> relight(const BasisFile& basis,
                                                std::span<const LightWeights> weights,
                                                const RelightOptions& options = {});
[[nodiscard]] RelitPicture relight(const BasisFile& basis, const LightWeights& weights,
                                   const RelightOptions& options = {});

/// sum of w_k T_k straight from a stack: the reference. Double accumulation.
[[nodiscard]] Image<float> relight_stack(const StackSource& stack, const LightWeights& weights);

}  // namespace haarlight::relight
