// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "relight/shadow/shadow_lookup.h"

namespace haarlight::relight {

/// The same planes with their pictures kept in memory, one byte per texel (V in 1/254), so that
/// several passes over the lights read and divide the capture once. The first pass has the rounded
/// values too. Pictures for which `memory_bytes` is not enough are requested again. One thread.
[[nodiscard]] std::vector<SamplingPlane> keep_pictures(std::span<const SamplingPlane> planes,
                                                       std::uint64_t memory_bytes);

}  // namespace haarlight::relight
