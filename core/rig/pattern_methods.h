// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of core/rig: patterns of lights.

namespace haarlight {

[[nodiscard]] std::vector<Method> pattern_methods();

}  // namespace haarlight
