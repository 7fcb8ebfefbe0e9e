// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "core/method.h"

/// @file
/// Every module's table of methods, joined.

namespace haarlight::bench {

[[nodiscard]] std::vector<Method> all_methods();

}  // namespace haarlight::bench
