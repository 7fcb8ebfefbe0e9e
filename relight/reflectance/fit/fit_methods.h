// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of relight/reflectance/fit: pictures lit by direction.

namespace haarlight::relight {

[[nodiscard]] std::vector<Method> fit_methods();

}  // namespace haarlight::relight
