// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// The table of methods of relight/light: weights of an environment.

namespace haarlight::relight {

[[nodiscard]] std::vector<Method> light_methods();

}  // namespace haarlight::relight
