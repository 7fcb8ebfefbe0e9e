// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>

#include "apps/volume_numbers.h"
#include "core/report.h"
#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "render/film/film.h"
#include "render/volume/volume_scene.h"

/// @file
/// What a picture of a volume is off by beside the exact one.

namespace haarlight::apps {

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
