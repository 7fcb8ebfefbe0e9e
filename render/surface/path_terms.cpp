// SPDX-License-Identifier: Apache-2.0
#include "render/surface/path_terms.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <numeric>
#include <utility>

#include <Eigen/Geometry>

#include "render/surface/direct_scene.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kTolerance =
    1e-12;  ///< of the mesh's size: rounding of flat polygons' corners

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

/// Closed, connected, of genus 0 and locally convex: then convex (Tietze's and Nakajima's theorem).
bool is_closed_and_convex(const Mesh& mesh, double size) {
  // Vertices at one position are one, whatever their number.
  std::map<std::array<double, 3>, int> numbers;
  std::vector<int> number_of(mesh.vertices.size());
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Vector3d& v = mesh.vertices[i];
    number_of[i] =
        numbers.emplace(std::array{v.x(), v.y(), v.z()}, static_cast<int>(numbers.size()))
            .first->second;
  }
  std::map<std::pair<int, int>, std::size_t> triangle_of;  // by directed edge
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    for (int e = 0; e < 3; ++e) {
      const int from = number_of[to_index(mesh.triangles[t][e])];
      const int to = number_of[to_index(mesh.triangles[t][(e + 1) % 3])];
      if (from == to || !triangle_of.emplace(std::pair{from, to}, t).second) {
        return false;
      }
    }
  }
  std::vector<std::size_t> part(mesh.triangles.size());  // of connected triangles
  std::iota(part.begin(), part.end(), std::size_t{0});
  const auto root = [&part](std::size_t i) {
    while (part[i] != i) {
      i = part[i] = part[part[i]];
    }
    return i;
  };
  std::size_t n_parts = mesh.triangles.size();
  std::vector<char> is_used(numbers.size(), 0);
  for (const auto& [edge, t] : triangle_of) {
    is_used[to_index(edge.first)] = 1;
    const auto other = triangle_of.find({edge.second, edge.first});
    if (other == triangle_of.end()) {
      return false;  // a rim
    }
    const Eigen::Vector3i& own = mesh.triangles[t];
    const Vector3d& a = mesh.vertices[to_index(own[0])];
    const Vector3d normal = (mesh.vertices[to_index(own[1])] - a)
                                .cross(mesh.vertices[to_index(own[2])] - a)
                                .normalized();
    for (const int i : mesh.triangles[other->second]) {
      if (normal.dot(mesh.vertices[to_index(i)] - a) > kTolerance * size) {
        return false;
      }
    }
    const std::size_t one = root(t);
    const std::size_t two = root(other->second);
    if (one != two) {
      part[one] = two;
      --n_parts;
    }
  }
  const auto n_vertices = std::ranges::count(is_used, char{1});
  const auto n_edges = static_cast<std::ptrdiff_t>(triangle_of.size() / 2);
  return n_parts == 1 &&
         n_vertices - n_edges + static_cast<std::ptrdiff_t>(mesh.triangles.size()) == 2;
}

}  // namespace

bool is_convex_or_flat(const Mesh& mesh) {
  if (mesh.triangles.empty()) {
    return false;
  }
  Eigen::AlignedBox3d box;
  for (const Vector3d& vertex : mesh.vertices) {
    box.extend(vertex);
  }
  const double size = box.sizes().norm();
  return is_flat(mesh) || is_closed_and_convex(mesh, size);
}

bool is_alone_and_convex(const Scene& scene) {
  const auto n_meshes = static_cast<std::size_t>(std::ranges::count_if(
      scene.meshes, [](const Mesh& mesh) { return !mesh.triangles.empty(); }));
  if (n_meshes + scene.spheres.size() + scene.disks.size() + scene.instances.size() != 1) {
    return false;
  }
  const auto lets_through = [&scene](const auto& surface) {
    return scene.materials[to_index(surface.material)].bsdf == BsdfKind::dielectric;
  };
  if (std::ranges::any_of(scene.meshes, lets_through) ||
      std::ranges::any_of(scene.spheres, lets_through) ||
      std::ranges::any_of(scene.disks, lets_through)) {
    return false;
  }
  return std::ranges::all_of(scene.meshes, [](const Mesh& mesh) {
    return mesh.triangles.empty() || is_convex_or_flat(mesh);
  });
}

}  // namespace haarlight::render
