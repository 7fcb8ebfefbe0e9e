// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>

#include "apps/viewer/publish_folder.h"
#include "haarlight/core/progress.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// A picture that is lit by direction as tiles that are loaded as they are seen: a deep zoom
/// image for every three planes, as OpenLIME reads it beside info.json.

namespace haarlight::apps {

inline constexpr int kPublishedTile = 512;  ///< pixels per side

struct PublishObjectOptions {
  std::optional<int> quality;  ///< JPEG tiles, 1 to 100; nothing: PNG, which loses nothing
  ProgressStyle progress = ProgressStyle::none;
};

struct PublishedObject {
  int levels = 0;
  bool has_info = false;  ///< info.json for OpenLIME: the format has words for the model
  /// JPEG: how far the pictures are from the file's, dB, over some of the tiles.
  std::optional<double> psnr_db;
};

/// Takes the planes level by level: needs a third of their memory more.
/// @param name  the file's, for the page
[[nodiscard]] PublishedObject publish_object(const relight::ReflectanceModel& model,
                                             const std::string& name, PublishFolder& folder,
                                             const PublishObjectOptions& options,
                                             const PublishNotes& notes);

/// Adds index.html and viewer/ to a web folder just written (web_folder.h): it then opens from
/// any web server, without tiles. Its readers do not see them. A page that stood there before
/// goes, also where none is written.
/// @return  false: nothing is written, the picture is too large for one texture
[[nodiscard]] bool add_page_to_web_folder(const std::filesystem::path& folder,
                                          const std::filesystem::path& web_folder);

}  // namespace haarlight::apps
