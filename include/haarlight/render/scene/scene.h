// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/film/film_settings.h"
#include "haarlight/render/light/square_light.h"
#include "haarlight/render/mesh/triangle_mesh.h"

/// @file
/// Input of a renderer: triangle meshes, spheres, disks, materials, lights. Knows no rig, no
/// session, no device. Lengths in mm, world frame.
///
/// Radiance has the unit of the scene's choice, U; then irradiance is in U sr, the intensity of a
/// point in U mm^2.

namespace haarlight::render {

/// How a material scatters. The formulas are in render/bsdf/.
enum class BsdfKind : std::uint8_t {
  blinn_phong,  ///< Lambert plus normalised Blinn-Phong: kd/pi + ks (n + 8)/(8 pi) (n.h)^n
  oren_nayar,   ///< rough diffuse: kd, sigma
  mirror,       ///< ideal: reflectance
  dielectric,   ///< ideal glass or water, the front outside: ior
  conductor,    ///< a rough metal: roughness, eta, k
  coated,       ///< Lambert under a rough dielectric coat: kd, ior, roughness
};
inline constexpr auto kBsdfWords = std::to_array<std::string_view>(
    {"blinn_phong", "oren_nayar", "mirror", "dielectric", "conductor", "coated"});
constexpr std::span<const std::string_view> words_of(BsdfKind) { return kBsdfWords; }

inline constexpr double kMaxUv = 1e9;            ///< size of a texture coordinate
inline constexpr double kMaxTextureScale = 1e6;  ///< of a scale
class Texture;                                   ///< render/scene/texture.h

/// A picture that multiplies a material's parameter: at texture coordinates (u, v) it is that of
/// (scale_u u, scale_v v), and repeats without end. Scenes are read with the file's name alone;
/// load_textures (render/scene/texture_files.h) reads the picture.
struct MaterialTexture {
  std::string file;  ///< its path; empty: no texture
  /// Where the picture lies within another file: its bytes as they are there, and `file` names it.
  std::shared_ptr<const std::string> bytes;
  std::string where;  ///< what names it, file:line, for errors
  Eigen::Vector2d scale = Eigen::Vector2d::Ones();
  std::shared_ptr<const Texture> picture;  ///< one for all materials of that file
};

/// What glTF calls metallic-roughness, where a picture is read for its mean over all texels
/// alone: until load_textures has done so the material has what the factors alone would be.
struct MetallicRoughness {
  Eigen::Vector3d base = Eigen::Vector3d::Ones();  ///< colour, RGB, linear
  double metallic = 1.0;
  double roughness = 1.0;             ///< as artists know it: alpha of GGX is its square
  bool is_matte = false;              ///< without a coat, where it is no metal
  MaterialTexture base_texture;       ///< multiplies base; a mean where the material is a metal
  MaterialTexture roughness_texture;  ///< green: roughness, blue: metallic; not sRGB
  MaterialTexture emission_texture;   ///< multiplies Material::emits
};

/// The parameters of all kinds; each kind reads its own.
struct Material {
  std::string name;
  Eigen::Vector3d kd = Eigen::Vector3d::Constant(0.5);  ///< diffuse albedo, RGB
  double ks = 0.0;                                      ///< 0 = Lambert only
  double exponent = 1.0;
  /// Radiance, RGB, from the front of its triangles (corners counter-clockwise) in all directions.
  /// `haarlight render` shows it; the virtual rig's light is that of its LEDs alone.
  Eigen::Vector3d emits = Eigen::Vector3d::Zero();
  BsdfKind bsdf = BsdfKind::blinn_phong;
  double sigma = 0.0;  ///< of the facets' slope angle, radians
  Eigen::Vector3d reflectance = Eigen::Vector3d::Ones();  ///< RGB
  double ior = 1.5;                                       ///< relative to the air outside
  double roughness = 0.1;                                 ///< alpha of GGX
  /// Complex index of refraction eta + i k, for red, green and blue.
  Eigen::Vector3d eta = Eigen::Vector3d::Ones();
  Eigen::Vector3d k = Eigen::Vector3d::Zero();
  MaterialTexture kd_texture;  ///< multiplies kd; its meshes have texture coordinates
  /// Of a coated one: kd, times its texture, is the colour that the coat lets see, which is lighter
  /// than what lies under it.
  bool is_kd_seen = false;
  std::shared_ptr<const MetallicRoughness> averaged;  ///< until load_textures
};

/// Exact, not tessellated. Its front is outside.
struct Sphere {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius_mm = 1.0;
  int material = 0;
};

/// Flat and round.
struct Disk {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, of its front
  double radius_mm = 1.0;
  int material = 0;
};

/// A point that emits, into all directions or into a cone.
struct PointLight {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d intensity = Eigen::Vector3d::Ones();  ///< RGB, within the cone's full part
  Eigen::Vector3d axis = -Eigen::Vector3d::UnitZ();     ///< unit, of the cone
  /// Full up to an angle to the axis of this cosine, none beyond the other, in between by the
  /// smooth step 3 t^2 - 2 t^3 of the cosine. -1 and -1: all directions.
  double cos_full = -1.0;
  double cos_end = -1.0;
};

/// Light from infinitely far, of one direction.
struct DirectionalLight {
  Eigen::Vector3d direction = -Eigen::Vector3d::UnitZ();  ///< unit, in which it shines
  Eigen::Vector3d irradiance = Eigen::Vector3d::Ones();   ///< RGB, on a surface that faces it
};

/// A picture of the light from infinitely far: cubemap.h reads it.
struct EnvironmentSource {
  std::filesystem::path file;
  double rotate_z_rad = 0.0;  ///< Environment::rotate
  double scale = 1.0;         ///< radiance of the scene over the picture's values
};

/// A mesh of the scene once more, elsewhere: its triangles are in memory once. The mesh itself
/// stays where it is. The front of its triangles stays their front, also where it is mirrored.
struct Instance {
  int mesh = 0;  ///< its number
  /// Of its vertices as they stand in the scene; finite, with an inverse.
  Eigen::Affine3d world_from_mesh = Eigen::Affine3d::Identity();
  int material = -1;  ///< -1: the mesh's
};

inline constexpr std::size_t kMaxInstances = std::size_t{1}
                                             << 20U;  ///< of a scene that is read

/// Most triangles of a scene that is read, and of one whose instances are expanded.
inline constexpr std::size_t kMaxTriangles = std::size_t{1} << 26U;  // about 10 GB with its BVH

/// A surface's number counts meshes first, then spheres, disks and instances. Any of them whose
/// material emits is a light.
struct Scene {
  std::vector<Material> materials;
  std::vector<Mesh> meshes;
  std::vector<Sphere> spheres;
  std::vector<Disk> disks;
  std::vector<Instance> instances;
  std::vector<SquareLight> lights;  ///< LEDs: they hide nothing, and no ray meets them
  std::vector<PointLight> point_lights;
  std::vector<DirectionalLight> directional_lights;
  std::optional<EnvironmentSource> environment;
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
  /// It sees nothing nearer or farther along its axis than these; 0: no such limit. What it does
  /// not see still casts shadows, reflects and emits.
  double near_mm = 0.0;
  double far_mm = 0.0;

  friend bool operator==(const CameraOptics&, const CameraOptics&) = default;
};

/// A scene file (TOML: [[mesh]] file, [[instance]], [[sphere]], [[box]], [[quad]], [[disk]],
/// [[material]], [[light]], [environment], [camera], [film]).
struct SceneFile {
  Scene scene;
  CameraModel camera;  ///< as the file has it: not yet of film's size
  CameraOptics optics;
  bool has_camera = false;
  FilmSettings film;
  std::vector<std::string>
      files;  ///< that were read beside it and are no pictures: glTF's .bin
};
/// A scene file, or a scene of glTF 2.0, told by the ending of its name, .gltf or .glb.
[[nodiscard]] SceneFile read_scene(const std::filesystem::path& path);

/// The same view in a picture of another size; where the sides' ratio is another, stretched.
[[nodiscard]] CameraModel resized(CameraModel camera, int width, int height);

/// Of all that a picture of it depends on, its textures' texels too, but not what an environment's
/// file contains (Environment::content_hash): 32 hexadecimal digits.
/// @throws ContractViolation  a texture that has not been loaded
[[nodiscard]] std::string hash_of(const SceneFile& file);

/// The instance's material.
[[nodiscard]] int material_of(const Scene& scene, const Instance& instance);

/// The instance as a mesh of its own, in the world frame. Normals by the inverse transpose, unit;
/// of a mirrored one the corners are in the order that keeps the front.
[[nodiscard]] Mesh mesh_of(const Scene& scene, const Instance& instance);

/// The same surfaces without instances, for what knows meshes alone: each is one more mesh after the
/// others, in the instances' order.
/// @param where  what names the scene, for the error
/// @throws Error  more than kMaxTriangles then
[[nodiscard]] Scene with_instances_expanded(Scene scene, const std::string& where);

/// Adds the meshes, instances, materials and square lights of one scene to another.
void append_scene(Scene& scene, const Scene& added);

}  // namespace haarlight::render
