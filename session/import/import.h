// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/picture/image_io.h"
#include "core/picture/picture_rectangle.h"
#include "core/progress.h"
#include "session/import/picture_match.h"
#include "session/import/white_reference.h"
#include "session/session.h"

/// @file
/// Others' captures (a folder of pictures and a list of lights) become a session like any
/// other, with asserted evidence. Its own target, haarlight::session_import: it brings the
/// libraries of picture files, which the daemon does not link.

namespace haarlight {

/// Where a neutral patch is in every picture.
struct WhitePatch {
  PixelRectangle patch;               ///< of the whole upright picture
  std::optional<double> reflectance;  ///< of it; nothing: only its colour counts
};

struct ImportOptions {
  LightPlaces places = LightPlaces::automatic;
  /// What the numbers of integer pictures stand for; nothing: as the files say (display
  /// pictures are sRGB).
  std::optional<Transfer> transfer{};
  MatchOptions match{};  ///< which picture is whose
  /// Rows and columns of each face's lights, which are listed row by row, face after face;
  /// nothing: looked for in the lights' positions (session/import/position_grid.h).
  std::optional<std::array<int, 2>> grid{};
  /// The frames' gains come from this patch (session/import/white_reference.h).
  std::optional<WhitePatch> white{};
  /// Only these pixels of the upright pictures enter; nothing: all.
  std::optional<PixelRectangle> crop{};
  bool force = false;  ///< replace an imported session of that name
  ProgressStyle progress = ProgressStyle::none;
};

struct ImportResult {
  SessionInfo info;
  std::vector<std::string> notes;          ///< what was assumed or passed over, for people
  std::vector<std::string> disagreements;  ///< of list and folder: each a warning
  std::optional<WhiteReference> white;     ///< where one was asked for
};

/// Reads the pictures that match_pictures() finds in the order of the light list and writes the
/// session `target`, which appears whole or not at all. 8-bit pictures stay as coded with their
/// transfer named; those with a colour profile that is neither sRGB nor linear become linear
/// floats (unless `transfer` is given) and the notes name it; EXIF rotation is ignored and
/// noted, but rectangles are of the upright picture.
/// @param light_file  empty: each picture says where its light is
/// (session/import/picture_lights.h)
/// @throws Error  naming picture and pixel: a picture missing, of another size or kind, with a
///                number that is none, with another one's pixels; a wrong count; a rectangle
///                outside of the pictures, or in pictures that are turned differently; no light
///                under which the white patch can be used; a target that exists
[[nodiscard]] ImportResult import_pictures(const std::filesystem::path& folder,
                                           const std::filesystem::path& light_file,
                                           const std::filesystem::path& target,
                                           const ImportOptions& options = {});

}  // namespace haarlight
