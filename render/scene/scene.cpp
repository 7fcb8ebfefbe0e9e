// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/scene/scene.h"

#include <algorithm>
#include <cstddef>
#include <span>
#include <type_traits>
#include <utility>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/scene/texture.h"

namespace haarlight::render {

namespace {

/// Hashes numbers, each list after its length.
class Hasher {
 public:
  template <class Number>
  void add(Number number) {
    static_assert(std::is_arithmetic_v<Number>);
    hash_.add(std::as_bytes(std::span<const Number, 1>(&number, 1)));
  }
  void add(const Eigen::Vector3d& v) { hash_.add(std::as_bytes(std::span(v.data(), 3))); }
  void add(const MaterialTexture& texture) {
    add(!texture.file.empty());
    if (!texture.file.empty()) {
      HAARLIGHT_EXPECTS(texture.picture != nullptr, "textures are loaded");
      hash_.add(std::as_bytes(std::span(texture.picture->hash())));
      add(texture.scale.x());
      add(texture.scale.y());
    }
  }
  template <class Vector>
  void add_all(const std::vector<Vector>& list) {
    static_assert(sizeof(Vector) ==
                  std::size_t{Vector::SizeAtCompileTime} * sizeof(typename Vector::Scalar));
    add(list.size());
    hash_.add(std::as_bytes(std::span(list)));
  }
  [[nodiscard]] std::string text() const { return hash_.text(); }

 private:
  ContentHash hash_;
};

}  // namespace

CameraModel resized(CameraModel camera, int width, int height) {
  const double sx = static_cast<double>(width) / camera.width;
  const double sy = static_cast<double>(height) / camera.height;
  camera.width = width;
  camera.height = height;
  camera.fx *= sx;
  camera.cx *= sx;
  camera.fy *= sy;
  camera.cy *= sy;
  return camera;
}

std::string hash_of(const SceneFile& file) {
  const Scene& scene = file.scene;
  const CameraModel& camera = file.camera;
  Hasher hash;
  hash.add(scene.materials.size());
  for (const Material& material : scene.materials) {
    HAARLIGHT_EXPECTS(material.averaged == nullptr, "textures are loaded");
    hash.add(material.kd);
    hash.add(material.ks);
    hash.add(material.exponent);
    hash.add(material.emits);
    hash.add(static_cast<int>(material.bsdf));
    hash.add(material.sigma);
    hash.add(material.reflectance);
    hash.add(material.ior);
    hash.add(material.roughness);
    hash.add(material.eta);
    hash.add(material.k);
    hash.add(material.kd_texture);
    if (material.is_kd_seen) {  // else the hash is that of materials before there were any such
      hash.add(true);
    }
  }
  hash.add(scene.meshes.size());
  for (const Mesh& mesh : scene.meshes) {
    hash.add_all(mesh.vertices);
    hash.add_all(mesh.triangles);
    hash.add_all(mesh.normals);
    hash.add_all(mesh.uvs);
    hash.add(mesh.material);
  }
  hash.add(scene.lights.size());
  for (const SquareLight& light : scene.lights) {
    for (const Eigen::Vector3d& vector : {light.centre, light.u, light.v, light.emits}) {
      hash.add(vector);
    }
    for (const double number :
         {light.width_mm, light.height_mm, light.lobe_mu, light.radiance}) {
      hash.add(number);
    }
  }
  hash.add(scene.spheres.size());
  for (const Sphere& sphere : scene.spheres) {
    hash.add(sphere.centre);
    hash.add(sphere.radius_mm);
    hash.add(sphere.material);
  }
  hash.add(scene.disks.size());
  for (const Disk& disk : scene.disks) {
    hash.add(disk.centre);
    hash.add(disk.normal);
    hash.add(disk.radius_mm);
    hash.add(disk.material);
  }
  hash.add(scene.point_lights.size());
  for (const PointLight& light : scene.point_lights) {
    for (const Eigen::Vector3d& vector : {light.position, light.intensity, light.axis}) {
      hash.add(vector);
    }
    hash.add(light.cos_full);
    hash.add(light.cos_end);
  }
  hash.add(scene.directional_lights.size());
  for (const DirectionalLight& light : scene.directional_lights) {
    hash.add(light.direction);
    hash.add(light.irradiance);
  }
  hash.add(scene.environment.has_value());
  if (scene.environment) {
    hash.add(scene.environment->rotate_z_rad);
    hash.add(scene.environment->scale);
  }
  for (const int side : {camera.width, camera.height}) {
    hash.add(side);
  }
  for (const double number :
       {camera.fx, camera.fy, camera.cx, camera.cy, file.optics.lens_radius_mm,
        file.optics.focus_mm, file.optics.pixel_mm, file.optics.near_mm, file.optics.far_mm}) {
    hash.add(number);
  }
  for (const double number : camera.distortion) {
    hash.add(number);
  }
  for (const double number : camera.world_from_cam.matrix().reshaped()) {
    hash.add(number);
  }
  if (!scene.instances.empty()) {  // else the hash is that of scenes before there were any
    hash.add(scene.instances.size());
    for (const Instance& instance : scene.instances) {
      hash.add(instance.mesh);
      for (const double number : instance.world_from_mesh.matrix().reshaped()) {
        hash.add(number);
      }
      hash.add(instance.material);
    }
  }
  return hash.text();
}

int material_of(const Scene& scene, const Instance& instance) {
  return instance.material >= 0
             ? instance.material
             : scene.meshes[static_cast<std::size_t>(instance.mesh)].material;
}

Mesh mesh_of(const Scene& scene, const Instance& instance) {
  Mesh mesh = scene.meshes[static_cast<std::size_t>(instance.mesh)];
  mesh.material = material_of(scene, instance);
  for (Eigen::Vector3d& vertex : mesh.vertices) {
    vertex = instance.world_from_mesh * vertex;
  }
  const Eigen::Matrix3d linear = instance.world_from_mesh.linear();
  const Eigen::Matrix3d for_normals = linear.inverse().transpose();
  for (Eigen::Vector3d& normal : mesh.normals) {
    normal = (for_normals * normal).normalized();
  }
  if (linear.determinant() < 0.0) {
    for (Eigen::Vector3i& triangle : mesh.triangles) {
      std::swap(triangle[1], triangle[2]);
    }
  }
  return mesh;
}

Scene with_instances_expanded(Scene scene, const std::string& where) {
  std::size_t n_triangles = 0;
  for (const Mesh& mesh : scene.meshes) {
    n_triangles += mesh.triangles.size();
  }
  for (const Instance& instance : scene.instances) {
    n_triangles += scene.meshes[static_cast<std::size_t>(instance.mesh)].triangles.size();
    if (n_triangles > kMaxTriangles) {
      throw Error("more than 2^26 triangles in the scene with each [[instance]] expanded",
                  where, "use fewer instances, or `haarlight render surface`");
    }
  }
  const std::vector<Instance> instances = std::move(scene.instances);
  scene.instances.clear();
  scene.meshes.reserve(scene.meshes.size() + instances.size());
  for (const Instance& instance : instances) {
    scene.meshes.push_back(mesh_of(scene, instance));
  }
  return scene;
}

void append_scene(Scene& scene, const Scene& added) {
  const int first_material = static_cast<int>(scene.materials.size());
  const int first_mesh = static_cast<int>(scene.meshes.size());
  scene.materials.insert(scene.materials.end(), added.materials.begin(), added.materials.end());
  for (const Mesh& mesh : added.meshes) {
    scene.meshes.push_back(mesh);
    scene.meshes.back().material += first_material;
  }
  for (Instance instance : added.instances) {
    instance.mesh += first_mesh;
    instance.material += instance.material >= 0 ? first_material : 0;
    scene.instances.push_back(instance);
  }
  scene.lights.insert(scene.lights.end(), added.lights.begin(), added.lights.end());
}

}  // namespace haarlight::render
