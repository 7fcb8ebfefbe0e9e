// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/enum_words.h"
#include "haarlight/session/session.h"

/// @file
/// Lists of lights as written by other programs: `.lp` (RTI), Relight's `.dome`, and our own
/// JSON (the "lights" of a session.json). Frame: x right, y up, z out of the picture. Pure
/// except for read_light_file.

namespace haarlight {
class JsonValue;
}

namespace haarlight::session {

/// The meaning of the three numbers of a `.lp` line; the file itself does not say.
enum class LightCoordinates {
  /// Directions; each whose length is not 1 to within 10 % is noted; refused when more than one
  /// in ten lengths are outside 0.5 to 2.
  automatic,
  directions,  ///< scaled to length 1
  positions,   ///< mm
};
inline constexpr auto kLightCoordinatesWords =
    std::to_array<std::string_view>({"automatic", "directions", "positions"});
constexpr std::span<const std::string_view> words_of(LightCoordinates) {
  return kLightCoordinatesWords;
}

struct LightList {
  /// `name` is the picture's, as written; empty where the file names none (`.dome`).
  std::vector<SessionLight> lights;
  std::size_t announced = 0;       ///< number of lights that the list states; 0: it states none
  std::vector<std::string> notes;  ///< what was skipped, for display
  /// Where the list contradicts itself or, after match_pictures(), its folder: each a warning.
  std::vector<std::string> disagreements;
};

/// `.lp`: first the number of lights, then one line per light: picture's name (spaces allowed)
/// x y z. Empty lines, lines that start with #, CRLF and a byte order mark are skipped; lines
/// without a name are allowed when all are. A count that is not that of the lines is a
/// disagreement: published lists have it.
/// @throws Error  with file:line: no count, not three finite numbers, a zero direction, one
///                picture twice
[[nodiscard]] LightList parse_lp(std::string_view text, const std::string& where,
                                 LightCoordinates coordinates = LightCoordinates::automatic);

/// Relight's `.dome`: directional uses `directions`, spherical and lights3d use positions (mm).
/// `ledAdjust` (a factor on pixel values) becomes 1 / relative power.
/// @throws Error  naming the field
[[nodiscard]] LightList parse_dome(std::string_view text, const std::string& where);

/// {"lights": [{"name", "direction" | "position_mm": [x, y, z], "relative_power"?, "axis"?: [x,
/// y, z], "lobe_mu"?}]}; the last two together, with a position.
/// @throws Error  naming the field
[[nodiscard]] LightList parse_light_json(std::string_view text, const std::string& where);

/// "axis" and "lobe_mu" of one light; nothing: both are absent.
/// @throws Error  naming the field: one without the other, not a unit vector, no position_mm
[[nodiscard]] std::optional<LightLobe> lobe_of_json(const JsonValue& light);

/// Any of the three, or a transforms.json (transforms_file.h), distinguished by content, not by
/// name. At least one light.
[[nodiscard]] LightList read_light_file(
    const std::filesystem::path& path,
    LightCoordinates coordinates = LightCoordinates::automatic);

/// @param names  one picture name per light
[[nodiscard]] std::string format_lp(const std::vector<Eigen::Vector3d>& directions,
                                    const std::vector<std::string>& names);

/// The header of a `.dome`, besides its lights.
struct DomeLabel {
  std::string label;
  std::string notes;
  double image_width_mm = 0.0;  ///< 0: unknown
};

/// Positions (mm, relative to the object's centre) give lights3d, directions give directional.
[[nodiscard]] std::string format_dome(const std::vector<SessionLight>& lights,
                                      const DomeLabel& label);

}  // namespace haarlight::session
