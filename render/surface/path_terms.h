// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// Which parts of path tracing a scene requires. What it cannot need is left out, and the picture
/// stays the same to the bit; `haarlight render surface --explain` tells which, why, and what each
/// would have cost.

namespace haarlight::render {

/// A part of the computation that some scenes do without.
enum class PathTerm : std::uint8_t {
  self_rays,        ///< rays from the scene's surfaces that may meet a surface
  met_lights,       ///< the last direction of a path, which can only meet a light
  light_choice,     ///< a choice among lights, by its probability at each point
  lobe_choice,      ///< the number by which a lobe of a material is chosen
  lens_points,      ///< the numbers for points of the camera's lens
  feature_channels  ///< albedo, normal, depth of the first surface that is seen
};
inline constexpr auto kPathTermWords =
    std::to_array<std::string_view>({"self_rays", "met_lights", "light_choice", "lobe_choice",
                                     "lens_points", "feature_channels"});
constexpr std::span<const std::string_view> words_of(PathTerm) { return kPathTermWords; }

/// A set of terms.
class PathTerms {
 public:
  constexpr PathTerms() = default;
  [[nodiscard]] constexpr bool has(PathTerm term) const { return (bits_ & bit(term)) != 0; }
  constexpr void add(PathTerm term) { bits_ |= bit(term); }

 private:
  static constexpr unsigned bit(PathTerm term) { return 1U << static_cast<unsigned>(term); }
  unsigned bits_ = 0;
};

/// Whether no ray that leaves a surface of the scene on its front meets a surface: a single sphere,
/// disk, flat mesh or closed convex mesh, and no material that lets light through.
[[nodiscard]] bool is_alone_and_convex(const Scene& scene);

/// Whether a closed mesh is convex, or a mesh flat: locally convex at each edge, connected, and of
/// Euler characteristic 2. Vertices may be 1e-12 of the mesh's size before a triangle's plane.
[[nodiscard]] bool is_convex_or_flat(const Mesh& mesh);

}  // namespace haarlight::render
