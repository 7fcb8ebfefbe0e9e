// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of render: direct light.

namespace haarlight::render {

[[nodiscard]] std::vector<Method> render_methods();

}  // namespace haarlight::render
