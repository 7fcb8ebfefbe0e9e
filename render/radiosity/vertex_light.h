// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/scene/scene.h"
#include "render/radiosity/patches.h"

/// @file
/// Irradiance of patches as it is shown: found at vertices, linear between them. Where it changes much
/// within a patch (beside another wall, around a block's foot), the patch is shown as four, and those
/// are again where the middles of edges are not what was interpolated there, as elements are in
/// [Cohen86]. There are at most as many new vertices as patches that light reaches have, or 500; where that
/// is not enough, those parts are cut that change most. A vertex that next to nothing reaches beside the
/// others (less than a hundredth) is covered, and left out.

namespace haarlight::render {

/// A vertex of a patch's side or of a part of it.
struct SideVertex {
  std::uint32_t triangle = 0;  ///< of Patches::triangles()
  bool is_front = true;
  /// Along the triangle's edges from its corner, in a patch's edges / 2^VertexLight::kLevels.
  Eigen::Vector2i at = Eigen::Vector2i::Zero();
};

class VertexLight {
 public:
  static constexpr int kLevels = 3;  ///< how often a patch is cut in four, at most

  /// The irradiance at a vertex: its number, its triangle, its side, where (barycentric, of second and
  /// third corner). Called on all threads.
  using Gather = std::function<Eigen::Vector3d(std::size_t number, const CutTriangle& triangle,
                                               bool is_front, const Eigen::Vector2d& uv)>;

  /// @param is_lit  (2 patches,): sides that any light reaches; of others the irradiance is 0
  VertexLight(const Scene& scene, const Patches& patches,
              const std::vector<std::uint8_t>& is_lit, const Gather& gather);

  /// An estimate from above.
  [[nodiscard]] static std::uint64_t bytes_needed(std::uint64_t n_patches);

  /// @param at  of the patch's own vertices
  [[nodiscard]] Eigen::Vector3d irradiance(const PatchPoint& at, bool is_front) const;

  /// Sides of patches, and parts that they were cut into.
  [[nodiscard]] std::size_t n_faces() const noexcept { return faces_.size(); }

 private:
  /// A side of a patch or a part of it. Children: at each corner one, then the middle one, whose
  /// corners are opposite to the parent's.
  struct Face {
    std::array<std::uint32_t, 3> vertices{};
    std::uint32_t first_child = 0;  ///< 0: none
  };
  class Maker;

  std::vector<Face> faces_;                  ///< the first are the patches' sides
  std::vector<Eigen::Vector3f> irradiance_;  ///< (vertices,)
};

}  // namespace haarlight::render
