// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file
/// How many threads a loop may count on.

namespace haarlight {

/// How many threads a parallel_for() (core/parallel.h) takes at most.
[[nodiscard]] int most_threads();

}  // namespace haarlight
