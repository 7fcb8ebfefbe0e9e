// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of relight/shadow: cast shadows.

namespace haarlight::relight {

[[nodiscard]] std::vector<Method> shadow_methods();

}  // namespace haarlight::relight
