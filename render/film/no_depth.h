// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace haarlight::render {

/// mm; the depth of a picture where it shows nothing, as other renderers write it.
inline constexpr double kNoDepth = 1e10;

}  // namespace haarlight::render
