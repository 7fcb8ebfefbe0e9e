// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/light/square_light.h"
#include "haarlight/render/mesh/triangle_mesh.h"

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
  /// Radiance, RGB, from the front of its triangles (corners counter-clockwise) in all directions.
  /// `haarlight render` shows it; the virtual rig's light is that of its LEDs alone.
  Eigen::Vector3d emits = Eigen::Vector3d::Zero();
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

/// In what a scene's camera is no pinhole.
struct CameraOptics {
  double lens_radius_mm = 0.0;  ///< of a thin lens's aperture; 0: all is sharp
  double focus_mm = 0.0;        ///< how far along the axis it is sharp
  double pixel_mm = 0.0;        ///< orthographic: side of a pixel in the scene; 0: perspective

  friend bool operator==(const CameraOptics&, const CameraOptics&) = default;
};

/// A scene file (TOML: [[mesh]] file, [[sphere]], [[box]], [[quad]], [[material]], camera).
struct SceneFile {
  Scene scene;
  CameraModel camera;
  CameraOptics optics;
  bool has_camera = false;
};
[[nodiscard]] SceneFile read_scene(const std::filesystem::path& path);

/// The same view in a picture of another size; where the sides' ratio is another, stretched.
[[nodiscard]] CameraModel resized(CameraModel camera, int width, int height);

/// Of all that a picture of it depends on: 32 hexadecimal digits.
[[nodiscard]] std::string hash_of(const SceneFile& file);

/// Adds the meshes and materials of one scene to another.
void append_scene(Scene& scene, const Scene& added);

}  // namespace haarlight::render
