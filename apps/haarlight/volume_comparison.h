// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "core/report.h"
#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "render/film/film.h"
#include "render/volume/volume_scene.h"

/// @file
/// What a picture of a volume is off by beside the exact one.

namespace haarlight::apps {

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

/// @param picture, exact  (n, 4), pixel by pixel @param behind  (n, 3): what is seen without the medium
[[nodiscard]] VolumeErrors compare_pictures(std::span<const double> picture,
                                            std::span<const double> exact,
                                            std::span<const double> behind);

/// |difference| of red, green and blue. @return (height, width, 3)
[[nodiscard]] Image<float> difference_of(std::span<const double> picture,
                                         std::span<const double> exact, int width, int height);

/// Renders the exact picture too; prints and reports what the film is off by, and draws it.
/// @param picture  to draw |difference| into: a .png with the largest as white @param seconds  that the
/// film took @throws Error(io)
void compare_with_exact(const render::VolumeScene& scene, const render::Film& film,
                        const std::string& picture, ProgressStyle progress, double seconds,
                        Report& report);

}  // namespace haarlight::apps
