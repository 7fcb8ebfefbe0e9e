// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

/// @file
/// Triangle meshes in memory, and tessellated primitives. Lengths in mm, world frame.

namespace haarlight::render {

/// Triangles with shared vertices. `normals` is empty (flat) or has one unit normal per vertex;
/// `uvs` is empty or has one pair of texture coordinates per vertex, u to the right and v up in
/// the picture, whose sides they span from 0 to 1.
struct Mesh {
  std::string name;
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
  std::vector<Eigen::Vector3d> normals;
  std::vector<Eigen::Vector2d> uvs;
  int material = 0;
};

/// Tessellated primitives. The sphere carries analytic normals, the quad's corners a, b, c, d the
/// texture coordinates (0, 0), (1, 0), (1, 1), (0, 1).
[[nodiscard]] Mesh make_box(const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                            int material);
[[nodiscard]] Mesh make_sphere(const Eigen::Vector3d& centre, double radius_mm,
                               int n_subdivisions, int material);
/// The same triangles in the same order, with texture coordinates: corners that have several are
/// as many vertices. A box: each side from 0 to 1, upright where it stands (v along z) and seen
/// from outside; top and bottom as seen from above and from below, with v along y and -y. A
/// sphere: u = azimuth / 2 pi from +x over +y, v from 0 at the bottom (-z) to 1 at the top, polar
/// angle / pi; at a pole each triangle has the mean u of its other corners. Between a triangle's
/// corners they are linear, off by about the square of its angle.
[[nodiscard]] Mesh make_textured_box(const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                                     int material);
[[nodiscard]] Mesh make_textured_sphere(const Eigen::Vector3d& centre, double radius_mm,
                                        int n_subdivisions, int material);
/// u and v of a sphere in that direction from its centre, unit; u in [0, 1).
[[nodiscard]] Eigen::Vector2d sphere_uv(const Eigen::Vector3d& direction);
[[nodiscard]] Mesh make_quad(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                             const Eigen::Vector3d& c, const Eigen::Vector3d& d, int material);

}  // namespace haarlight::render
