// SPDX-License-Identifier: Apache-2.0
#include "render/surface/direct_scene.h"

#include <algorithm>
#include <cstddef>

#include <Eigen/Geometry>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kTolerance = 1e-12;  ///< of the mesh's size: rounding of corners

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

double size_of(const Mesh& mesh) {
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : mesh.vertices) {
    box.extend(vertex);
  }
  return box.sizes().norm();
}

/// Whether some light may leave a surface of that material again.
bool reflects(const Material& material) {
  switch (material.bsdf) {
    case BsdfKind::blinn_phong:
      return !material.kd.isZero(0.0) || material.ks > 0.0;
    case BsdfKind::oren_nayar:
      return !material.kd.isZero(0.0);
    case BsdfKind::mirror:
      return !material.reflectance.isZero(0.0);
    case BsdfKind::dielectric:
    case BsdfKind::conductor:
    case BsdfKind::coated:
      break;
  }
  return true;
}

}  // namespace

bool has_indirect_light(const Scene& scene) {
  const auto material_of_surface = [&scene](const auto& surface) -> const Material& {
    return scene.materials[to_index(surface.material)];
  };
  std::size_t n_reflecting = 0;
  bool is_flat_and_opaque = true;
  const auto count = [&](const Material& material, bool is_flat_one) {
    if (reflects(material)) {
      ++n_reflecting;
      is_flat_and_opaque &= is_flat_one && material.bsdf != BsdfKind::dielectric;
    }
  };
  for (const Mesh& mesh : scene.meshes) {
    if (!mesh.triangles.empty()) {
      count(material_of_surface(mesh), is_flat(mesh));
    }
  }
  for (const Sphere& sphere : scene.spheres) {
    count(material_of_surface(sphere), false);
  }
  for (const Disk& disk : scene.disks) {
    count(material_of_surface(disk), true);
  }
  for (const Instance& instance : scene.instances) {
    count(scene.materials[to_index(material_of(scene, instance))], false);
  }
  return n_reflecting > 1 || !is_flat_and_opaque;
}

bool is_flat(const Mesh& mesh) {
  const double size = size_of(mesh);
  Vector3d normal = Vector3d::Zero();
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Vector3d& a = mesh.vertices[to_index(t[0])];
    const Vector3d area =
        (mesh.vertices[to_index(t[1])] - a).cross(mesh.vertices[to_index(t[2])] - a);
    if (area.squaredNorm() > normal.squaredNorm()) {
      normal = area;
    }
  }
  if (!(normal.norm() > 0.0)) {
    return false;
  }
  normal.normalize();
  const Vector3d& on_it = mesh.vertices[to_index(mesh.triangles.front()[0])];
  return std::ranges::all_of(mesh.triangles, [&](const Eigen::Vector3i& t) {
    return std::ranges::all_of(t, [&](int i) {
      return std::abs(normal.dot(mesh.vertices[to_index(i)] - on_it)) <= kTolerance * size;
    });
  });
}

}  // namespace haarlight::render
