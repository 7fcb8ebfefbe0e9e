// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of relight/basis: compressing and relighting.

namespace haarlight::relight {

[[nodiscard]] std::vector<Method> basis_methods();

}  // namespace haarlight::relight
