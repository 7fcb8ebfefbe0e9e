#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>

#include "relight/formats/reflectance.h"

/// @file
/// Relight's folder for the web: info.json and plane_0.jpg, plane_1.jpg ..., three planes in
/// each. OpenLIME shows it. Field by field: docs/reflectance-formats.md.

namespace haarlight {

/// True for a folder with an info.json.
[[nodiscard]] bool is_web_folder(const std::filesystem::path& path);

/// The bytes of one file of the folder, by its name.
using OpenPart = std::function<std::string(const std::string& name)>;

/// Basis ptm or hsh in rgb or lrgb; rbf or bilinear in mrgb or mycc, which becomes pca. Tiles
/// are not read, nor folders of several materials.
/// @param where       the folder's name, for messages
/// @param most_bytes  of planes
/// @throws Error  naming the field of info.json, or the picture
[[nodiscard]] ReflectanceModel parse_web_folder(std::string_view info, const OpenPart& open,
                                                const std::string& where,
                                                std::uint64_t most_bytes = kMostPlaneBytes);
[[nodiscard]] ReflectanceModel read_web_folder(const std::filesystem::path& folder,
                                               std::uint64_t most_bytes = kMostPlaneBytes);

/// Which planes of the model picture i of the folder holds in its R, G and B; -1: none, zeros.
[[nodiscard]] std::array<int, 3> planes_of_picture(const ReflectanceModel& model, int picture);

/// What info.json says beside the model.
struct WebInfoWords {
  std::string format = "jpg";  ///< ending of the pictures
  int quality = 95;            ///< of JPEG pictures
  std::optional<double> mm_per_pixel;
};

/// The text of info.json. Scales, axes: as write_web_folder.
/// @param where  for errors
/// @throws Error  a model that the format has no word for
[[nodiscard]] std::string web_info_text(const ReflectanceModel& model, const std::string& where,
                                        const WebInfoWords& words);

/// The field pixelSizeInMM of a folder's info.json, which OpenLIME reads; nothing where it has
/// none. @throws Error  info.json is not readable
[[nodiscard]] std::optional<double> web_mm_per_pixel(const std::filesystem::path& folder);

struct WebOptions {
  int quality = 95;  ///< of the JPEG pictures, 1 to 100
};

/// Writes the pictures, then info.json; the folder is made where it is not there. Scales obey
/// ScaleRule::any. Axes of pca become bytes, each row with its own range, as the format has it;
/// the mean is clipped to 0..1.
/// @throws Error  16 terms of hsh in lrgb or another model that the format has no word for; not
///                srgb; unwritable
void write_web_folder(const std::filesystem::path& folder, const ReflectanceModel& model,
                      const WebOptions& options = {});

}  // namespace haarlight
