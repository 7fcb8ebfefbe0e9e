// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "haarlight/render/rays/ray.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A scene's triangles cut into patches. Each edge of a triangle is cut into n equal parts and the
/// triangle by lines between them into n^2 patches, all of its own shape; n is such that patches of
/// all triangles are as alike in area as that allows. Spheres and disks have none.
///
/// A surface reflects on both sides, so each patch has two sides: 2 p its front, 2 p + 1 its back.

namespace haarlight::render {

/// A triangle of the scene, and how it is cut.
struct CutTriangle {
  std::uint32_t surface = 0;   ///< number in the scene: of a mesh or an instance
  std::uint32_t triangle = 0;  ///< of the mesh
  Eigen::Vector3d corner = Eigen::Vector3d::Zero();
  Eigen::Vector3d to_second = Eigen::Vector3d::Zero();
  Eigen::Vector3d to_third = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, of its front
  double area_mm2 = 0.0;
  int n = 0;                    ///< parts of an edge; 0: without area, not cut
  std::size_t first_patch = 0;  ///< n^2 from here on
  /// (n + 1)(n + 2)/2 from here on: where the lines meet, row by row from its first edge.
  std::size_t first_vertex = 0;

  /// The vertex i parts along the first edge and j along the second from the corner.
  [[nodiscard]] std::size_t vertex(int i, int j) const {
    return first_vertex + static_cast<std::size_t>(j * (n + 1) - j * (j - 1) / 2 + i);
  }
  [[nodiscard]] Eigen::Vector3d at(const Eigen::Vector2d& uv) const {
    return corner + uv.x() * to_second + uv.y() * to_third;
  }
};

/// Where in a patch, and which vertices it has.
struct PatchPoint {
  std::size_t patch = 0;
  std::array<std::size_t, 3> vertices{};
  std::array<double, 3> weights{};  ///< of the vertices, linear; sum 1
};

class Patches {
 public:
  /// @param most  patches, if there are not more triangles
  Patches(const Scene& scene, std::size_t most);

  [[nodiscard]] std::size_t size() const noexcept { return n_patches_; }
  [[nodiscard]] std::size_t n_vertices() const noexcept { return n_vertices_; }
  [[nodiscard]] const std::vector<CutTriangle>& triangles() const noexcept {
    return triangles_;
  }
  /// Triangles of a scene, instances expanded.
  [[nodiscard]] static std::size_t n_triangles(const Scene& scene);

  [[nodiscard]] const CutTriangle& triangle_of(std::size_t patch) const;
  [[nodiscard]] double area_mm2(std::size_t patch) const;
  /// A point of a patch in its triangle's barycentric coordinates of second and third corner.
  /// @param square  in [0, 1)^2; even there is even on the patch
  [[nodiscard]] Eigen::Vector2d uv_in(std::size_t patch, const Eigen::Vector2d& square) const;

  /// In row j the i-th that stands as the triangle does, or the upside-down one beside it.
  [[nodiscard]] static std::size_t patch_of(const CutTriangle& triangle, int i, int j,
                                            bool is_upside_down) {
    return triangle.first_patch + static_cast<std::size_t>(j * (2 * triangle.n - j) + 2 * i +
                                                           (is_upside_down ? 1 : 0));
  }

  /// Nothing: what was hit is not cut.
  [[nodiscard]] std::optional<PatchPoint> find(const RawHit& hit) const;
  /// @param uv  barycentric, of second and third corner
  [[nodiscard]] static PatchPoint find_in(const CutTriangle& triangle,
                                          const Eigen::Vector2d& uv);

 private:
  std::vector<CutTriangle> triangles_;
  /// By surface: the number of its first triangle; of spheres and disks none.
  std::vector<std::optional<std::size_t>> first_of_surface_;
  std::vector<std::uint32_t> triangle_of_patch_;
  std::size_t n_patches_ = 0;
  std::size_t n_vertices_ = 0;
};

}  // namespace haarlight::render
