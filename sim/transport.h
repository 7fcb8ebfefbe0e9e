// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "haarlight/core/progress.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/scene/scene.h"
#include "render/surface/indirect_light.h"
#include "sim/transport_file.h"

/// @file
/// Renders the light transport matrix T[pixel][light] of a virtual rig once and caches it by
/// the hash of everything it depends on. Direct light, and what bounces if asked; definition:
/// docs/reference/simulator.md.

namespace haarlight::sim {

struct TransportOptions {
  int n_subpixels = 2;  ///< mean of n x n sub-pixel centres
  /// A pixel whose sub-pixels show one smooth surface takes the light at its own centre. What
  /// that costs and saves: docs/reference/simulator.md.
  bool subpixels_at_edges = false;
  render::DirectLightOptions direct{};
  render::IndirectOptions indirect{};
  std::filesystem::path cache_folder;  ///< empty: default_transport_cache()
  /// For the matrix while it is made, in strips of rows; the scene's own tables come on top.
  std::uint64_t memory_bytes = std::uint64_t{1} << 30U;
  ProgressStyle progress = ProgressStyle::none;
};

/// $XDG_CACHE_HOME/haarlight, or ~/.cache/haarlight, or the temporary folder.
[[nodiscard]] std::filesystem::path default_transport_cache();

/// The hash of everything T depends on: lights, camera geometry and mosaic, scene, options.
[[nodiscard]] std::string transport_key(const Rig& rig, int camera, const render::Scene& scene,
                                        const TransportOptions& options);

/// T of one camera of the rig: a mono sensor responds to the mean of red, green and blue, a
/// Bayer sensor to the colour of each pixel. Computed on all threads, bit for bit the same on
/// any number of them and within any memory. A damaged cache file is recomputed.
/// @throws Error(io)     the cache folder cannot be written, or has no room for the matrix
/// @throws Error(usage)  memory_bytes is not enough for one row of pixels; it says what is
[[nodiscard]] Transport make_transport(const Rig& rig, int camera, const render::Scene& scene,
                                       const TransportOptions& options = {});

}  // namespace haarlight::sim
