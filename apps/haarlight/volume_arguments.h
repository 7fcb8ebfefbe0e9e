// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "apps/haarlight/render_film.h"
#include "apps/haarlight/volume_picture.h"
#include "haarlight/core/enum_words.h"
#include "render/volume/cell_projection.h"
#include "render/volume/projected_tetrahedra.h"
#include "render/volume/volume_mode.h"

/// @file
/// What `haarlight render volume` is told.

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

}  // namespace haarlight::apps
