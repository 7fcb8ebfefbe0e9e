// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "haarlight/relight/basis/basis_file.h"

/// @file
/// From the products of the coefficients' error pictures to the bound that a file stores.
/// Method: docs/numerics/relight.md, "The coding error's bound".

namespace haarlight::relight {

/// @param products     (channels, gram_size(n_lights)), in the order of coefficients
/// @param norms        (channels, n_lights), light-domain index: ProductBound's p_i
/// @param rests        (channels): PictureBound::rests
/// @param block_bytes  of the file's blocks: the vectors may take an eighth of that
[[nodiscard]] PictureBound fit_picture_bound(const BasisHeader& header,
                                             std::span<const double> products,
                                             std::span<const float> norms,
                                             std::span<const double> rests, double block_bytes);

/// The next float upwards.
[[nodiscard]] float round_up(double v);

}  // namespace haarlight::relight
