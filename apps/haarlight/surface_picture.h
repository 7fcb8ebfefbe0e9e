// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "haarlight/core/picture/picture_window.h"
#include "render/film/film_file.h"

/// @file
/// Pictures of the film of a scene's surfaces.

namespace haarlight::apps {

/// Settings of a film that say which part of a picture it is: render::crop_text().
inline constexpr const char* kPictureSetting = "picture";
inline constexpr const char* kCropSetting = "crop";

/// The whole picture of which a film's is a crop.
/// @param path  of the film or the scene, for errors
[[nodiscard]] PictureWindow window_of(const render::RenderSettings& settings,
                                      const std::string& path);

/// Beside an .exr a .png to look at.
/// @param samples  of the pixel that has fewest: one has no error @param error_picture  empty: none
/// @return the exposure of the .png, 1 where there is none
double write_surface_pictures(const render::Film& film, const PictureWindow& window,
                              std::uint32_t samples, const std::string& output,
                              const std::string& error_picture,
                              std::optional<double> asked_exposure);

/// "16 samples each"
[[nodiscard]] std::string samples_words(std::uint32_t least, std::uint32_t most);

}  // namespace haarlight::apps
