// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of soft shadows.

namespace haarlight::render {

[[nodiscard]] std::vector<Method> soft_shadow_methods();

}  // namespace haarlight::render
