// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of relight/shape: normals and heights.

namespace haarlight::relight {

[[nodiscard]] std::vector<Method> shape_methods();

}  // namespace haarlight::relight
