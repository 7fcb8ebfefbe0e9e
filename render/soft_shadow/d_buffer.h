// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/rays/ray_caster.h"
#include "render/soft_shadow/disk_visibility.h"
#include "render/soft_shadow/flat_light.h"
#include "render/soft_shadow/occluder_edges.h"
#include "render/soft_shadow/shadow_grid.h"

/// @file
/// The D-buffer of [Jakobsen04]: a picture of the occluders and of their umbra and penumbra volumes
/// from a disk light's centre, that keeps one silhouette edge a texel, and the visibility that
/// follows if that edge alone parts the light. Kept to be compared with SoftShadow's exact way: by
/// `haarlight render soft-shadow --method d-buffer` and `paper`. Light frame, lengths in its radius.
/// What hides the centre is found with a bias of one texel: nearer contacts let light through.

namespace haarlight::render {

/// Which of several volumes on a texel's ray counts.
enum class VolumeTest : std::uint8_t {
  /// Of a piece the nearest umbra plane, of the pieces in the way the one whose umbra ends last; the
  /// nearest penumbra. Edges are kept, distances are those of the receiver's own ray. Borders are
  /// exact for closed convex pieces.
  by_piece,
  /// As printed: the farthest of everything (section 4), distances of the texel's middle, x_s by
  /// equation 2, silhouette faces drawn as part of the umbra volume.
  farthest,
};

struct DBufferOptions {
  int texels = 512;  ///< across and down
  VolumeTest test = VolumeTest::by_piece;
  VisibilityForm form = VisibilityForm::exact;
};

struct DBufferCounts {
  std::int64_t n_umbra_edges = 0;
  std::int64_t n_penumbra_edges = 0;
  std::int64_t n_without_extrusion = 0;  ///< edges whose line meets the disk: left out
  std::int64_t n_rays = 0;
};

class DBuffer {
 public:
  /// @param scene   of triangles, without instances
  /// @param light   a disk
  /// @param vertices, planes  of `edges`, light frame; planes as unit normal, offset. These and all
  ///                above outlive it
  /// @throws Error  a sphere or a disk that is in the way of the light; an edge with more than two
  ///                triangles of a mesh, or two that run the same way along it. Open edges are allowed:
  ///                they are silhouettes of both kinds
  /// @param where   what names the scene, for errors
  DBuffer(const Scene& scene, const OccluderEdges& edges, const FlatLight& light,
          std::span<const Eigen::Vector3d> vertices, std::span<const Eigen::Vector4d> planes,
          const DBufferOptions& options, const std::string& where);

  /// Draws the buffer. @param receivers  light frame, those that it must cover
  void draw(const RayCaster& caster, std::span<const Eigen::Vector3d> receivers);

  struct Value {
    double visibility = 1.0;
    bool is_assumed =
        false;  ///< that one edge parts the light: it does, or 0 and 1 are certain
    bool is_clamped = false;  ///< t was outside of [0, 1]
  };
  /// @param receiver  that draw() covered, z > kNearestZ
  [[nodiscard]] Value at(const Eigen::Vector3d& receiver) const;

  [[nodiscard]] const DBufferCounts& counts() const noexcept { return counts_; }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffU;

  /// An edge on a silhouette, before the light.
  struct VolumeEdge {
    Eigen::Vector3d v1;
    Eigen::Vector3d v2;
    std::uint32_t piece = 0;
    std::array<std::uint32_t, 2> vertices = {kNone,
                                             kNone};  ///< kNone: cut off at the light's plane
    std::array<std::uint32_t, 2> faces = {kNone, kNone};
    std::optional<Eigen::Vector3d> umbra;  ///< touching_plane()
    std::optional<Eigen::Vector3d> penumbra;
    Eigen::Vector2d umbra_rim = Eigen::Vector2d::Zero();
    Eigen::Vector2d penumbra_rim = Eigen::Vector2d::Zero();
  };
  /// What a ray from the centre meets of a volume: an edge's side, or the cone over a vertex.
  struct Winner {
    std::uint32_t edge = kNone;
    bool is_cone = false;  ///< over the edge's first or second vertex
    bool is_second = false;
    double distance = 0.0;       ///< infinite: never
    double edge_distance = 0.0;  ///< x_s
  };
  struct Entered {
    std::uint32_t face = kNone;  ///< by which the ray enters a piece
    Winner umbra;
  };
  struct Texel {
    std::uint32_t first = 0;  ///< of entered_
    std::uint32_t n = 0;
    Winner penumbra;
  };
  struct Crossing {
    std::uint32_t face;
    double distance;
  };

  void set_pieces();
  void set_edges(const std::string& where);
  void add_edge(const OccluderEdge& edge, std::span<const std::uint32_t> faces);
  int find_crossings(const RayCaster& caster, const Eigen::Vector3d& direction,
                     std::vector<Crossing>& crossed) const;
  void fill(Texel& texel, std::vector<Entered>& entered, std::span<const Crossing> crossed,
            const ShadowGrid::Cell& cell, const Eigen::Vector3d& direction) const;
  [[nodiscard]] Winner farthest_umbra(std::span<const Crossing> crossed,
                                      const ShadowGrid::Cell& cell,
                                      const Eigen::Vector3d& direction) const;
  [[nodiscard]] Winner penumbra_at(const ShadowGrid::Cell& cell,
                                   const Eigen::Vector3d& direction) const;
  /// Distance and x_s of a winner along another ray.
  void measure(Winner& winner, bool is_umbra, const Eigen::Vector3d& direction) const;
  [[nodiscard]] std::optional<double> cone_distance(const VolumeEdge& edge, bool is_second,
                                                    const Eigen::Vector3d& direction) const;
  [[nodiscard]] double plane_of_edge(const VolumeEdge& edge,
                                     const Eigen::Vector3d& direction) const;
  [[nodiscard]] Value value_of(double t, const Winner& winner) const;

  const Scene& scene_;
  const OccluderEdges& edges_;
  const FlatLight& light_;
  DBufferOptions options_;
  DBufferCounts counts_;
  std::span<const Eigen::Vector3d> vertices_;
  std::span<const Eigen::Vector4d> planes_;
  std::vector<std::uint32_t> pieces_;                 ///< of each vertex
  std::vector<std::vector<std::uint32_t>> faces_of_;  ///< of each mesh's triangles
  std::vector<VolumeEdge> silhouette_;
  /// Ends of the penumbra edges that meet in each vertex.
  std::vector<std::vector<std::uint32_t>> around_;
  std::optional<ShadowGrid> grid_;
  std::vector<Texel> texels_;
  std::vector<Entered> entered_;
};

}  // namespace haarlight::render
