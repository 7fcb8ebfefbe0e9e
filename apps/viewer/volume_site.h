// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>

#include "apps/viewer/viewer_site.h"
#include "http/site.h"

/// @file
/// What `haarlight view` answers for the scene of a volume: its pictures from wherever the page looks,
/// with whatever transfer functions. Paths and layouts: docs/reference/http-api.md, "The viewer's
/// server".

namespace haarlight::apps {

/// Reads the scene and its mesh, and keeps them.
/// @throws Error  as read_volume_scene(), read_scene_words() and VolumeViews
[[nodiscard]] http::HttpSite volume_site(const std::filesystem::path& file,
                                         std::uint64_t memory_bytes,
                                         const ViewerConfig& config);

}  // namespace haarlight::apps
