// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "relight/basis/basis_file.h"

/// @file
/// Is a basis file whole? Opening one reads its head only.

namespace haarlight {

/// Reads and decodes every block. In parallel; a tile a thread in memory.
/// @throws Error  the first damage found, with its tile, group and byte
void check_basis(const BasisFile& basis);

}  // namespace haarlight
