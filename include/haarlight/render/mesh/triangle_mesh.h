// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

/// @file
/// Triangle meshes in memory, and tessellated primitives. Lengths in mm, world frame.

namespace haarlight::render {

/// Triangles with shared vertices. `normals` is empty (flat) or has one unit normal per vertex.
struct Mesh {
  std::string name;
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
  std::vector<Eigen::Vector3d> normals;
  int material = 0;
};

/// Tessellated primitives. The sphere carries analytic normals.
[[nodiscard]] Mesh make_box(const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                            int material);
[[nodiscard]] Mesh make_sphere(const Eigen::Vector3d& centre, double radius_mm,
                               int n_subdivisions, int material);
[[nodiscard]] Mesh make_quad(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                             const Eigen::Vector3d& c, const Eigen::Vector3d& d, int material);

}  // namespace haarlight::render
