// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// Relight's web folder: info.json and plane_0.jpg, plane_1.jpg ..., three planes in each.
/// OpenLIME shows it. Field by field: docs/reference/reflectance-formats.md.

namespace haarlight::relight {

/// True for a folder with an info.json.
[[nodiscard]] bool is_web_folder(const std::filesystem::path& path);

/// The bytes of one file of the folder, by its name.
using OpenPart = std::function<std::string(const std::string& name)>;

/// Basis ptm or hsh in rgb or lrgb; rbf or bilinear in mrgb or mycc, which becomes pca. Tiles
/// and folders of several materials are not supported. Lit as in OpenLIME 1.2.6: rbf without
/// sigma, hsh no lower than kWebLeastElevation; lrgb's colours are brought to 0..1 and the
/// luminance with them.
/// @param where       the folder's name, for messages
/// @param most_bytes  of planes
/// @throws Error  naming the field of info.json, or the picture
[[nodiscard]] ReflectanceModel parse_web_folder(std::string_view info, const OpenPart& open,
                                                const std::string& where,
                                                std::uint64_t most_bytes = kMostPlaneBytes);
[[nodiscard]] ReflectanceModel read_web_folder(const std::filesystem::path& folder,
                                               std::uint64_t most_bytes = kMostPlaneBytes);

/// OpenLIME 1.2.6 uses lrgb's luminance as the picture's opacity. At this many times the factor
/// for colours in 0..1, it is 1 or more (opaque) wherever an 8-bit picture is not black.
inline constexpr double kWebLuminance = 255.0;

/// Default quality of a folder's pictures.
inline constexpr double kWebQuality = 97.0;

/// Which planes of the model picture i of the folder holds in its R, G and B; -1: none, zeros.
[[nodiscard]] std::array<int, 3> planes_of_picture(const ReflectanceModel& model, int picture);

/// What info.json contains besides the model.
struct WebInfoWords {
  std::string format = "jpg";    ///< extension of the pictures
  double quality = kWebQuality;  ///< of JPEG pictures
  std::optional<double> mm_per_pixel;
};

/// The text of info.json. Scales, axes: as write_web_folder.
/// @param where  for errors
/// @throws Error  a model that the format cannot express
[[nodiscard]] std::string web_info_text(const ReflectanceModel& model, const std::string& where,
                                        const WebInfoWords& words);

/// The size of a folder's picture, from its info.json alone.
struct WebSize {
  int width = 0;
  int height = 0;
  int n_planes = 0;
};
/// @throws Error  naming the field of info.json
[[nodiscard]] WebSize web_folder_size(const std::filesystem::path& folder);

/// The field pixelSizeInMM of a folder's info.json, which OpenLIME reads; nothing if absent.
/// @throws Error  info.json is not readable
[[nodiscard]] std::optional<double> web_mm_per_pixel(const std::filesystem::path& folder);

struct WebOptions {
  /// 1 to 100. Every plane is quantised in steps that change the lit pictures equally, by
  /// web_step().
  double quality = kWebQuality;
};

/// The quantisation step of a quality, in 255ths of white of a lit picture: JPEG's own step for
/// the mean of a picture's blocks; 0 at 100, where every plane's step is one byte.
[[nodiscard]] double web_step(double quality) noexcept;

/// A folder's files in memory.
struct WebFiles {
  std::string info;
  std::vector<std::string> pictures;  ///< plane_0.jpg, ...
  double quality = kWebQuality;
  [[nodiscard]] std::uint64_t bytes() const noexcept;
};

/// @param where  the folder's name, for messages
/// @throws Error  as write_web_folder, except for errors of writing
[[nodiscard]] WebFiles code_web_folder(const ReflectanceModel& model, const WebOptions& options,
                                       const std::string& where);
/// The model that a reader of these files gets.
[[nodiscard]] ReflectanceModel decode_web_files(const WebFiles& files, const std::string& where,
                                                std::uint64_t most_bytes = kMostPlaneBytes);
/// @throws Error(io)
void write_web_files(const std::filesystem::path& folder, const WebFiles& files);

/// Codes the model and writes the pictures, then info.json; the folder is created if missing.
/// Scales obey ScaleRule::any. Axes of pca become bytes, each row with its own range, as in the
/// format; the mean is clipped to 0..1. For lrgb the luminance is written multiplied by
/// kWebLuminance, the colours divided by it.
/// @throws Error  16 terms of hsh, rbf (viewers have their own rules for it), or another model
///                that the format cannot express; not srgb; unwritable
void write_web_folder(const std::filesystem::path& folder, const ReflectanceModel& model,
                      const WebOptions& options = {});

}  // namespace haarlight::relight
