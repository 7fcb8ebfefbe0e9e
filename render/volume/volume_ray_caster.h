// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "render/loop/tile_renderer.h"
#include "render/volume/cell_faces.h"
#include "render/volume/light_sum.h"
#include "render/volume/volume_mode.h"
#include "render/volume/volume_scene.h"

/// @file
/// The exact picture of a mesh of tetrahedra whose fields are linear within them: rays through the
/// pixels' centres walk from cell to cell through the faces, are cut at the breakpoints of the
/// transfer functions, and gather what each piece emits in closed form (segment.h) [Williams98].
///
/// Cells with bent edges are walked through by the points at which the ray passes their faces
/// (bent_face.h). A ray for which rounding leaves open which faces it passes, or in which order, is moved
/// sideways by little and followed anew before any light is added; such rays are counted.
///
/// Nothing is approximated: what remains is rounding (docs/numerics/volume.md). A ray passes each cell
/// once, also along edges and through vertices (side_of_ray.h). Holes, separate parts and faces that
/// meet only in part are no special cases: a ray enters wherever it meets the boundary.
///
/// Pieces can be integrated by other rules, to be compared: volume_mode.h.

namespace haarlight::render {

struct VolumeOptions {
  /// By how much a pixel may be off, in units of its light: a ray ends where no more than that can
  /// come from behind. 0: never, but where double has no number for it.
  double max_error = 0.0;
  /// Of mode series the tolerance is that of max_error: half of it for the pieces, half for the end.
  VolumeRule rule;
  /// How faces are kept; for comparison.
  FaceForm faces = FaceForm::tetrahedra_where_all_are;
  /// The scene's cells by connect_cells(), to share them between views; empty: they are connected.
  std::shared_ptr<const CellFaces> connected;
};

/// What a picture took.
struct VolumeCounts {
  std::uint64_t rays = 0;         ///< that met the mesh
  std::uint64_t cells = 0;        ///< passed
  std::uint64_t segments = 0;     ///< between breakpoints, that were not empty
  std::uint64_t exact_sides = 0;  ///< decided by exact arithmetic
  std::uint64_t lost_points =
      0;                         ///< whose coordinates in their cell were not found to rounding
  std::uint64_t unresolved = 0;  ///< stretches that no polynomial fits to rounding
  /// Met a bent face along it, or its border: moved by 1e-14 of what is seen, or more.
  std::uint64_t moved_rays = 0;
  std::uint64_t undecided_rays =
      0;                          ///< the same however often they were moved; part is missing
  std::uint64_t opaque_rays = 0;  ///< ended before they left the mesh
  RuleCounts rule;                ///< of a mode other than exact
};

struct VolumeView;

/// What is to be known of a pixel, in a film that is kept: bits of the layer kFlags.
struct PixelFlag {
  static constexpr unsigned kEnded = 1;       ///< its ray ended before it left the mesh
  static constexpr unsigned kUnresolved = 2;  ///< its field is not known to rounding somewhere
  static constexpr unsigned kOverlap = 4;     ///< its ray was in two cells at once: no picture
};

class VolumeRayCaster final : public TileRenderer {
 public:
  /// @param scene  outlives it
  /// @throws Error  as connect_cells() and require_sizes(); optical depths beyond kLargestDepth
  VolumeRayCaster(const VolumeScene& scene, const VolumeOptions& options);
  ~VolumeRayCaster() override;
  VolumeRayCaster(const VolumeRayCaster&) = delete;
  VolumeRayCaster& operator=(const VolumeRayCaster&) = delete;

  /// What it and its scene take, for a check before it is made.
  [[nodiscard]] static std::uint64_t bytes_needed(const VolumeScene& scene);
  /// How long the constructor took.
  [[nodiscard]] double prepare_seconds() const { return prepare_seconds_; }

  /// Layers of the film: the light, over what is behind; the opacity of the medium in front of it; the
  /// depth in mm along the camera's axis at which half of what is behind is hidden, by the medium or
  /// by a surface behind it, else kNoDepth; PixelFlag.
  static constexpr std::size_t kLight = 0;
  static constexpr std::size_t kOpacity = 1;
  static constexpr std::size_t kDepth = 2;
  static constexpr std::size_t kFlags = 3;
  [[nodiscard]] static std::vector<FilmLayer> layers();

  /// For a film of the camera's size, one sample of each pixel: through its centre.
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

  [[nodiscard]] VolumeCounts counts() const;
  /// What a ray that ended leaves out of its pixel, at most, in units of its light: at most max_error.
  [[nodiscard]] double left_out() const { return least_transparency_ * brightest_; }
  /// Of a mode other than exact, once the picture is rendered: by how much a pixel's light may be off,
  /// in its units, at most. Nothing: no such bound is known.
  [[nodiscard]] std::optional<double> error_bound() const;
  /// Once the picture is rendered.
  /// @throws Error  a ray was in two cells at once: by their numbers in the file
  void require_no_overlap() const;

 private:
  class TilePicture;

  void add(const VolumeCounts& counts) const;

  std::unique_ptr<const VolumeView> view_;
  VolumeRule rule_;
  double brightest_ = 0.0;  ///< light that a ray without anything before it can gather
  double least_transparency_ = 0.0;
  double prepare_seconds_ = 0.0;
  mutable std::mutex mutex_;
  mutable VolumeCounts counts_;
  mutable std::optional<std::string> overlap_;
};

struct PixelLight;
struct HiddenFrom;
/// What a pixel's ray has gathered, over what is behind, into the layers above. @param flags  PixelFlag
void add_pixel(const VolumeScene& scene, int x, int y, const PixelLight& pixel,
               const HiddenFrom& hidden, unsigned flags, FilmTile& tile);

}  // namespace haarlight::render
