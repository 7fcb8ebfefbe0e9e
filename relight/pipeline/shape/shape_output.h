// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "haarlight/core/image.h"
#include "relight/pipeline/shape/shape_pipeline.h"

/// @file
/// The files of a recovered surface.

namespace haarlight::relight {

/// Writes options.out: normals, albedo and errors (for measured shapes; else front.png),
/// heights, mask, preview, meshes. @return  bytes of the folder's files
/// @throws Error  unwritable; a mesh without triangles
[[nodiscard]] std::uint64_t write_shape(const ShapePipelineOptions& options,
                                        const ShapeSummary& summary);

/// The values of the known pixels, all channels.
/// @param known  (height, width)
[[nodiscard]] std::vector<float> known_values(const Image<float>& picture,
                                              const Image<std::uint8_t>& known);

}  // namespace haarlight::relight
