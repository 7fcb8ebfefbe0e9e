// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string_view>
#include <vector>

#include "haarlight/core/image.h"
#include "render/film/film.h"
#include "render/volume/volume_scene.h"

/// @file
/// The numbers of a volume's film: what its files and the viewer show of it, and what it is off by
/// beside another. Pure but for the file.

namespace haarlight::apps {

inline constexpr std::size_t kVolumeChannels = 4;  ///< of a pixel: R, G, B and the opacity

/// visit(x, y) of the pixels of tiles without samples.
void for_each_missing_pixel(const render::Film& film,
                            const std::function<void(int x, int y)>& visit);

/// R, G, B and the opacity of each pixel, row by row; NaN where nothing is rendered.
[[nodiscard]] std::vector<double> doubles_of(const render::Film& film);
/// A layer; NaN where nothing is rendered.
[[nodiscard]] Image<float> layer_of(const render::Film& film, std::size_t layer);
/// Of a .png to look at: 98 % of the values are not clipped. NaN are left out.
[[nodiscard]] double shown_exposure(std::span<const float> values);
/// Light, and in an .exr opacity and depth as channels A and Z. @throws Error(io)
void write_linear_picture(const render::Film& film, const std::filesystem::path& path);

/// Of |difference|, over the pixels that see the medium.
struct ChannelErrors {
  double mean = 0.0;
  double at_99 = 0.0;  ///< 99 % are at most that
  double worst = 0.0;
};

/// Red, green, blue, and the opacity.
struct VolumeErrors {
  static constexpr std::array<std::string_view, 4> kNames = {"red", "green", "blue", "opacity"};
  std::int64_t n_compared = 0;
  std::array<ChannelErrors, 4> channels;
};

/// R, G and B of each pixel without the medium.
[[nodiscard]] std::vector<double> lights_behind(const render::VolumeScene& scene);

/// @param picture, exact  (n, 4), pixel by pixel @param behind  (n, 3): what is seen without the medium
[[nodiscard]] VolumeErrors compare_pictures(std::span<const double> picture,
                                            std::span<const double> exact,
                                            std::span<const double> behind);

}  // namespace haarlight::apps
