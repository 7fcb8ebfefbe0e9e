#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/image_io.h"
#include "core/progress.h"
#include "session/light_file.h"
#include "session/session.h"

/// @file
/// Others' captures (a folder of pictures and a list of lights) become a session like any
/// other, with asserted evidence. Its own target, haarlight::session_import: it brings
/// OpenImageIO, which the daemon does not link.

namespace haarlight {

struct ImportOptions {
  LightPlaces places = LightPlaces::automatic;
  /// What the numbers of integer pictures stand for; nothing: as the files say (display
  /// pictures are sRGB).
  std::optional<Transfer> transfer{};
  std::vector<std::filesystem::path> dark{};  ///< pictures of the same view with all lights off
  std::vector<std::string>
      exclude{};       ///< pictures whose names contain one of these are no lights'
  bool force = false;  ///< replace an imported session of that name
  ProgressStyle progress = ProgressStyle::none;
};

struct ImportResult {
  SessionInfo info;
  std::vector<std::string> notes;  ///< what was assumed or passed over, for people
};

/// The names of a folder's pictures, known by their endings, in natural order: a2 before a10.
/// @throws Error  a folder that cannot be listed
[[nodiscard]] std::vector<std::string> picture_names(const std::filesystem::path& folder);

/// Reads `folder`'s pictures in the order of the light list (its names, or, where it has none,
/// all pictures in natural order of names) and writes the session `target`, which appears whole
/// or not at all. 8-bit pictures stay as coded with their transfer named; EXIF rotation is
/// ignored and noted.
/// @throws Error  naming picture and pixel: a picture missing, of another size or kind, with a
///                number that is none; a wrong count; a target that exists
[[nodiscard]] ImportResult import_pictures(const std::filesystem::path& folder,
                                           const std::filesystem::path& light_file,
                                           const std::filesystem::path& target,
                                           const ImportOptions& options = {});

}  // namespace haarlight
