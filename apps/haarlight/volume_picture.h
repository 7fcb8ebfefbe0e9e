// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <optional>
#include <string>

#include "render/film/film_file.h"

/// @file
/// Pictures of a volume's film, whole or not.

namespace haarlight::apps {

/// What a volume's film holds.
struct VolumeFilmFacts {
  std::size_t n_rendered = 0;         ///< tiles
  std::size_t ended_pixels = 0;       ///< whose rays ended before they left the mesh
  std::size_t unresolved_pixels = 0;  ///< whose field is not known to rounding
  std::size_t overlaps = 0;           ///< pixels whose rays were in two cells at once
  int overlap_x = 0;                  ///< the first of them
  int overlap_y = 0;
};
[[nodiscard]] VolumeFilmFacts facts_of(const render::Film& film);

/// Prints what is to be known of the picture. @param left_out  of a ray that ended, at most
void tell_doubts(const VolumeFilmFacts& facts, double left_out);

/// Setting of a film: what was allowed to rays that ended, fmt's shortest text.
inline constexpr const char* kMaxErrorSetting = "max_error";
/// What a ray that ended leaves out, at most, as far as the film tells: what was allowed; 0 where none
/// ended.
[[nodiscard]] double left_out_of(const render::RenderSettings& settings,
                                 const VolumeFilmFacts& facts);

/// What is written of a film; empty names are not.
struct VolumePictureNames {
  std::string output;   ///< beside an .exr a .png to look at
  std::string float64;  ///< .npy: R, G, B and opacity of each pixel
  std::optional<double> exposure;
};

/// Refuses names that are taken or have the wrong ending. @throws Error(usage)
void require_volume_outputs(const VolumePictureNames& names, bool force);

/// Pixels of tiles that are missing are NaN; in a .png they are hatched.
/// @return the exposure of the .png, 1 where there is none @throws Error(io)
double write_volume_pictures(const render::Film& film, const VolumePictureNames& names);

}  // namespace haarlight::apps
