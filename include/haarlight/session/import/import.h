// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/picture/picture_rectangle.h"
#include "haarlight/core/progress.h"
#include "haarlight/session/import/picture_match.h"
#include "haarlight/session/import/white_reference.h"
#include "haarlight/session/session.h"

/// @file
/// Captures made elsewhere (a folder of pictures and a list of lights) become an ordinary
/// session, with asserted evidence. A target of its own, haarlight::session_import: it needs
/// the image file libraries, which the daemon does not link.

namespace haarlight::session {

/// The position of a neutral patch in every picture.
struct WhitePatch {
  PixelRectangle patch;               ///< of the whole upright picture
  std::optional<double> reflectance;  ///< of the patch; nothing: only its colour counts
};

struct ImportOptions {
  LightCoordinates coordinates = LightCoordinates::automatic;
  /// The meaning of the numbers in integer pictures; nothing: as the files say (display
  /// pictures are sRGB).
  std::optional<Transfer> transfer{};
  MatchOptions match{};  ///< which picture belongs to which light
  /// Rows and columns of each face's lights, which are listed row by row, face after face;
  /// nothing: detected from the lights' positions (session/import/position_grid.h).
  std::optional<std::array<int, 2>> grid{};
  /// The frames' gains come from this patch (haarlight/session/import/white_reference.h).
  std::optional<WhitePatch> white{};
  /// Only these pixels of the upright pictures are imported; nothing: all.
  std::optional<PixelRectangle> crop{};
  bool force = false;  ///< replace an imported session of the same name
  ProgressStyle progress = ProgressStyle::none;
};

struct ImportResult {
  SessionInfo info;
  std::vector<std::string> notes;          ///< what was assumed or skipped, for display
  std::vector<std::string> disagreements;  ///< between list and folder: each a warning
  std::optional<WhiteReference> white;     ///< if requested
};

/// Reads the pictures that match_pictures() finds in the order of the light list and writes the
/// session `target`, which appears whole or not at all. 8-bit pictures stay encoded with their
/// transfer named; those with a colour profile that is neither sRGB nor linear become linear
/// floats (unless `transfer` is given), as the notes report; EXIF rotation is ignored and
/// noted, but rectangles refer to the upright picture.
/// @param light_file  empty: each picture states its light's position
/// (session/import/picture_lights.h)
/// @throws Error  naming picture and pixel: a picture missing, of another size or kind, with a
///                value that is not a number, or with another one's pixels; a wrong count; a
///                rectangle outside the pictures, or in pictures of different orientation; no
///                light under which the white patch is usable; a target that exists
[[nodiscard]] ImportResult import_pictures(const std::filesystem::path& folder,
                                           const std::filesystem::path& light_file,
                                           const std::filesystem::path& target,
                                           const ImportOptions& options = {});

}  // namespace haarlight::session
