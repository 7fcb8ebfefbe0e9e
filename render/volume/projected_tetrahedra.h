// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/core/enum_words.h"
#include "render/loop/tile_renderer.h"
#include "render/volume/cell_tetrahedra.h"
#include "render/volume/tetrahedron_fan.h"
#include "render/volume/volume_scene.h"

/// @file
/// Previews of a medium: fast, approximate pictures by projected tetrahedra [Shirley90].
///
/// Each tetrahedron is seen as a fan of up to four triangles about its thick point, the one place where
/// two of its edges, or a corner and a face, are in front of each other: there it has a thickness, and at
/// its other corners none. Thickness, extinction and colour are interpolated linearly over the triangles'
/// pixels, and composited in float, the nearest first. Cells of other types are cut into tetrahedra, and
/// extinction and colour are linear within these between what the transfer functions say at their
/// corners: rows of the scene's tables within a cell are missed. Errors against the exact picture, and
/// their order in the size of the cells: docs/numerics/volume.md.

namespace haarlight::render {

/// The previews of [Williams98], section 7. Its M2, as M3 but by tables, would save nothing: docs.
enum class Preview : std::uint8_t {
  m0,  ///< opacity at the thick point, interpolated; the mean of the colours before and behind
  m1,  ///< the exponential in each pixel, of interpolated thickness and extinction; colours as M0
  m3,  ///< as M1, but at the thick point what its ray gathers exactly
};
inline constexpr auto kPreviewWords = std::to_array<std::string_view>({"m0", "m1", "m3"});
constexpr std::span<const std::string_view> words_of(Preview) { return kPreviewWords; }

/// In which order tetrahedra are composited.
enum class PreviewOrder : std::uint8_t {
  centroid,  ///< of their centroids' distances: approximate, wrong where large cells touch small ones
  exact,  ///< of visibility_order(), and within a cell by centroids
};
inline constexpr auto kPreviewOrderWords =
    std::to_array<std::string_view>({"centroid", "exact"});
constexpr std::span<const std::string_view> words_of(PreviewOrder) {
  return kPreviewOrderWords;
}

struct PreviewOptions {
  Preview method = Preview::m1;
  PreviewOrder order = PreviewOrder::centroid;
};

/// What all views of a mesh share.
struct PreviewMesh {
  /// @param scene  without contours and surfaces behind; outlives it
  /// @throws ContractViolation  with these, which previews do not draw
  explicit PreviewMesh(const VolumeScene& scene);

  const VolumeScene& scene;
  std::vector<CellTetrahedron> tetrahedra;
  std::vector<float> extinction;       ///< 1/mm, of points, or of cells
  std::vector<Eigen::Array3f> colour;  ///< of points, or of cells
  double prepare_seconds = 0.0;
};

/// What a view took.
struct PreviewCounts {
  std::size_t tetrahedra = 0;  ///< of all cells
  std::size_t drawn = 0;  ///< that have a pixel's centre in their box, clipped parts included
  std::size_t clipped =
      0;  ///< cut at a clipping plane, or where they are much nearer here than there
  std::size_t split_cells = 0;  ///< of an exact order: that it splits, and the preview does not
};

/// One view of a mesh.
class ProjectedTetrahedra final : public TileRenderer {
 public:
  /// @param mesh  outlives it; its scene's camera is the view
  /// @throws Error  of an exact order, as visibility_order()
  explicit ProjectedTetrahedra(const PreviewMesh& mesh, const PreviewOptions& options = {});
  ~ProjectedTetrahedra() override;
  ProjectedTetrahedra(const ProjectedTetrahedra&) = delete;
  ProjectedTetrahedra& operator=(const ProjectedTetrahedra&) = delete;

  /// What it, its mesh and its scene take, for a check before they are made.
  [[nodiscard]] static std::uint64_t bytes_needed(const VolumeScene& scene, PreviewOrder order);
  /// How long the constructor took: anew for each view.
  [[nodiscard]] double view_seconds() const { return view_seconds_; }
  [[nodiscard]] const PreviewCounts& counts() const { return counts_; }
  /// In perspective what is nearer along the axis is left out, mm; where the mesh ends farther away,
  /// nothing is.
  [[nodiscard]] double nearest() const { return near_; }

  /// A film with the layers of VolumeRayCaster, of the camera's size, one sample of each pixel; without
  /// a depth.
  /// @return  tetrahedra drawn
  std::uint64_t render_tile(SampleRange samples, FilmTile& tile) const override;

 private:
  /// Where a tetrahedron is on the film.
  struct Placed {
    float distance = 0.0F;                 ///< of its centroid
    std::array<std::uint16_t, 2> first{};  ///< tile, across and down
    std::array<std::uint16_t, 2> end{};    ///< the same: none
  };
  enum class Reach : std::uint8_t { outside, inside, across };

  void see_points();
  [[nodiscard]] Reach reach_of(const std::array<std::uint32_t, 4>& nodes) const;
  [[nodiscard]] Placed place(const std::array<Eigen::Vector3d, 4>& corners) const;
  [[nodiscard]] Eigen::Vector3d on_picture(const Eigen::Vector3d& camera) const;
  [[nodiscard]] FanCorner corner_of(std::uint32_t node, std::uint32_t cell) const;
  [[nodiscard]] std::array<FanCorner, 4> corners_of(std::uint32_t number) const;
  [[nodiscard]] std::uint32_t cell_of(std::uint32_t number) const;
  void place_tetrahedra();
  void clip_tetrahedron(std::uint32_t number);
  void sort_by_distance();
  void sort_by_cells();
  void sort_into_tiles();

  const PreviewMesh& mesh_;
  PreviewOptions options_;
  bool is_perspective_;
  double near_ = 0.0;
  double far_;
  Eigen::Isometry3d camera_from_world_;
  /// On the picture, as FanCorner; without meaning where z is not between near_ and far_.
  std::vector<Eigen::Vector3d> points_;
  std::vector<Placed> placed_;  ///< of each tetrahedron, and then of each clipped part
  std::vector<std::array<FanCorner, 4>> clipped_;
  std::vector<std::uint32_t> clipped_cells_;
  std::vector<std::uint32_t> order_;  ///< numbers in placed_, the nearest first
  /// Of tile i those from tile_begins_[i] to tile_begins_[i + 1], the nearest first.
  std::vector<std::size_t> tile_begins_;
  std::vector<std::uint32_t> of_tiles_;
  int tiles_across_ = 0;
  PreviewCounts counts_;
  double view_seconds_ = 0.0;
};

}  // namespace haarlight::render
