// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/relight/basis/basis_file.h"

/// @file
/// Whether a basis file is intact; opening one reads only its header.

namespace haarlight::relight {

/// Reads and decodes every block. In parallel; one tile per thread in memory.
/// @throws Error  the first damage found, with its tile, group and byte offset
void check_basis(const BasisFile& basis);

}  // namespace haarlight::relight
