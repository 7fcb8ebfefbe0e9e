// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

/// @file
/// When render::run() looks at the error.

namespace haarlight::render {

/// The first count of samples per pixel, at least `samples`, after which the error is looked at;
/// RunOptions::kAnySamples where there is none before.
[[nodiscard]] std::uint32_t look_after(double samples);

}  // namespace haarlight::render
