// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"

/// @file
/// Input of a renderer: triangle meshes, spheres, boxes, materials, square area lights. Knows
/// no rig, no session, no device. Lengths in mm, world frame.

namespace haarlight::render {

/// Lambert plus normalised Blinn-Phong: f = kd/pi + ks (n + 8)/(8 pi) (n.h)^n.
struct Material {
  std::string name;
  Eigen::Vector3d kd = Eigen::Vector3d::Constant(0.5);  ///< diffuse albedo, RGB
  double ks = 0.0;                                      ///< 0 = Lambert only
  double exponent = 1.0;
};

/// Triangles with shared vertices. `normals` is empty (flat) or has one unit normal per vertex.
struct Mesh {
  std::string name;
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Eigen::Vector3i> triangles;
  std::vector<Eigen::Vector3d> normals;
  int material = 0;
};

/// A flat rectangular emitter.
struct SquareLight {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();  ///< unit
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();  ///< unit
  Eigen::Vector3d emits = -Eigen::Vector3d::UnitZ();
  double width_mm = 1.0;   ///< along u
  double height_mm = 1.0;  ///< along v
  double radiance = 1.0;   ///< along the normal
  double lobe_mu = 1.0;    ///< radiance ~ cos^(mu - 1) of the angle to `emits`
};

struct Scene {
  std::vector<Material> materials;
  std::vector<Mesh> meshes;
  std::vector<SquareLight> lights;
};

/// Wavefront OBJ with usemtl; materials from the .mtl next to it, or decoded from names of the
/// form kd_ks_exponent (docs/reference/scene-file.md); or PLY (ascii, binary little-endian),
/// one mesh.
/// @throws Error  with file:line (or offset) and a hint: bad index, NaN, no triangles
[[nodiscard]] Scene read_obj(const std::filesystem::path& path);
[[nodiscard]] Scene read_ply(const std::filesystem::path& path);

/// A scene file (TOML: [[mesh]] file, [[sphere]], [[box]], [[quad]], [[material]], camera).
struct SceneFile {
  Scene scene;
  CameraModel camera;
  bool has_camera = false;
};
[[nodiscard]] SceneFile read_scene(const std::filesystem::path& path);

/// Tessellated primitives. The sphere carries analytic normals.
[[nodiscard]] Mesh make_box(const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                            int material);
[[nodiscard]] Mesh make_sphere(const Eigen::Vector3d& centre, double radius_mm,
                               int n_subdivisions, int material);
[[nodiscard]] Mesh make_quad(const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                             const Eigen::Vector3d& c, const Eigen::Vector3d& d, int material);

/// Adds the meshes and materials of one scene to another.
void append_scene(Scene& scene, const Scene& added);

}  // namespace haarlight::render
