// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

#include "apps/haarlight/verb.h"
#include "apps/haarlight/volume_arguments.h"
#include "render/volume/volume_scene.h"

/// @file
/// `haarlight render volume` by cells, in the order in which they are seen: exact, or a preview.

namespace haarlight::apps {

/// Of its options, what does not go together. @throws Error(usage)
void check_algorithm(const VolumeArguments& arguments);
/// Refuses what a preview does not draw. @throws Error(usage)
void check_preview(const render::VolumeScene& scene, const VolumeArguments& arguments);

/// What the algorithm takes but for the film.
[[nodiscard]] std::uint64_t bytes_of_algorithm(const render::VolumeScene& scene,
                                               const VolumeArguments& arguments);

/// Prints and reports which faces are not drawn as they are.
void tell_faces(const render::VolumeScene& scene, Report& report);

[[nodiscard]] ExitCode project_cells(const render::VolumeScene& scene,
                                     const VolumeArguments& arguments,
                                     const CommonOptions& common, Report& report);
[[nodiscard]] ExitCode draw_preview(const render::VolumeScene& scene,
                                    const VolumeArguments& arguments,
                                    const CommonOptions& common, Report& report);

/// --algorithm and what belongs to it.
void add_algorithm_options(Command& verb, VolumeArguments& arguments);

}  // namespace haarlight::apps
