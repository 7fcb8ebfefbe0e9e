// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "apps/haarlight/render_film.h"
#include "apps/haarlight/verb.h"
#include "apps/haarlight/volume_picture.h"
#include "haarlight/core/enum_words.h"
#include "render/volume/cell_projection.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/volume_mode.h"

/// @file
/// `haarlight render volume` by cells, in the order in which they are seen: exact, or a preview.

namespace haarlight::apps {

/// Two ways to the same picture, and one to another.
enum class Algorithm : std::uint8_t { ray_casting, cell_projection, projected_tetrahedra };
inline constexpr auto kAlgorithmWords =
    std::to_array<std::string_view>({"ray-casting", "cell-projection", "projected-tetrahedra"});
constexpr std::span<const std::string_view> words_of(Algorithm) { return kAlgorithmWords; }

struct VolumeArguments {
  std::string scene;
  VolumePictureNames names;
  FilmArguments kept;
  std::vector<int> size;
  double max_error = 0.0;
  std::optional<double> seconds;
  Algorithm algorithm = Algorithm::ray_casting;
  std::optional<render::Preview> preview;
  std::optional<render::PreviewOrder> order;
  render::SmallCells small_cells = render::SmallCells::sampled;
  render::VolumeMode mode = render::VolumeMode::exact;
  std::optional<int> points;
  std::optional<double> piece_depth;
  std::string comparison;
};

/// Of the options above, what does not go together. @throws Error(usage)
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
