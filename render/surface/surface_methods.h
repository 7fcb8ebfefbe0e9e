// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of path tracing: what it leaves out or leaves to chance.

namespace haarlight::render {

[[nodiscard]] std::vector<Method> surface_methods();

}  // namespace haarlight::render
