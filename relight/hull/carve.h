// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/core/progress.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/scene/scene.h"
#include "relight/hull/voxel_grid.h"
#include "relight/shadow/shadow_lookup.h"

/// @file
/// Carving: what the shadow pictures of a capture say about each voxel over the plane
/// (relatives: space carving of visual hulls [Laurentini94], shadow carving [Savarese07]). Where
/// light k is seen lit at plane point p, the beam between them is empty. The visibility of a
/// square light is the visible fraction of its area, so V(p, k) > 1/2 says that the ray to its
/// centre is open, up to the form of the edge: penumbrae do not blur the hull. One beam is not a
/// proof: with noise sigma it is worth min(cap, -ln Q((V - 1/2)/sigma)), Q the upper tail of the
/// normal distribution, the log likelihood ratio that V would be as bright or brighter were the
/// centre blocked. A voxel is empty when its beams are worth `evidence_limit` together.
/// docs/numerics/hull.md.

namespace haarlight::relight {

struct CarveOptions {
  /// Standard deviation of V: noise, compression, and the plate's error.
  double visibility_sigma = 0.08;
  /// The most that one beam counts, so that a few bad frames carve nothing.
  double beam_cap = 3.0;
  /// Together: the odds exp(limit) that the voxel is empty. At least limit/cap lights agree.
  double evidence_limit = 12.0;
  std::uint64_t memory_bytes = std::uint64_t{1} << 30U;  ///< for pictures of lights
  ProgressStyle progress = ProgressStyle::none;
};

/// A camera whose pixels show either a plane or the object.
struct CarvingView {
  CameraModel camera;
  /// (h, w, 1) of the camera: 1 where the ray surely ends on a plane.
  Image<std::uint8_t> shows_plane;
  /// (h, w, 1): 1 where it surely ends on the object; outlines and the dark are neither.
  Image<std::uint8_t> shows_object;
};

/// Per voxel, in the grid's order.
struct CarveResult {
  /// Worth of the beams that were seen lit, in units of 1/kEvidenceUnits, saturated at the limit.
  std::vector<std::uint16_t> lit_evidence;
  std::vector<std::uint16_t>
      n_seen;  ///< lights whose beam through the voxel ended on known points of some plane
  std::vector<std::uint8_t> is_empty;
  int n_lights = 0;  ///< that shine on some plane past the grid
  std::uint64_t n_lookups = 0;
};
inline constexpr int kEvidenceUnits = 5;

/// @param planes  shadow pictures of each, requested light by light from this thread
/// @param lights  as in the rig; those behind a plane tell nothing there. Which side of a plane
///                the grid is on decides, not the plane's normal
/// The result does not depend on threads or memory.
[[nodiscard]] CarveResult carve(const VoxelGrid& grid, std::span<const SamplingPlane> planes,
                                std::span<const render::SquareLight> lights,
                                std::span<const CarvingView> views,
                                const CarveOptions& options = {});

}  // namespace haarlight::relight
