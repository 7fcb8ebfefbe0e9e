// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>

#include "relight/basis/light_basis.h"
#include "relight/study/array_grid.h"

namespace haarlight::relight {

/// CDF 5/3 over the lights of each face by lifting (dyadic_transform.h), for any number of rows
/// and columns. Biorthogonal: not a FixedBasis.
/// @throws ContractViolation  no grid
[[nodiscard]] std::shared_ptr<const LightBasis> make_cdf53_basis(const ArrayGrid& grid);

}  // namespace haarlight::relight
