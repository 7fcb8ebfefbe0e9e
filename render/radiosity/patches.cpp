// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/patches.h"

#include <algorithm>
#include <cmath>
#include <span>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

void add_triangles(const Mesh& mesh, std::uint32_t surface,
                   std::vector<CutTriangle>& triangles) {
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3i& corners = mesh.triangles[t];
    CutTriangle cut{.surface = surface, .triangle = static_cast<std::uint32_t>(t)};
    cut.corner = mesh.vertices[to_index(corners[0])];
    cut.to_second = mesh.vertices[to_index(corners[1])] - cut.corner;
    cut.to_third = mesh.vertices[to_index(corners[2])] - cut.corner;
    const Vector3d area = cut.to_second.cross(cut.to_third);
    const double length = area.stableNorm();
    cut.area_mm2 = 0.5 * length;
    if (length > 0.0) {
      cut.normal = area / length;
    }
    triangles.push_back(cut);
  }
}

/// Parts of an edge for patches of about that area; of no area none.
int parts_of(const CutTriangle& triangle, double patch_area) {
  constexpr double kMostParts = 1 << 14;
  return triangle.area_mm2 > 0.0
             ? static_cast<int>(
                   std::clamp(std::sqrt(triangle.area_mm2 / patch_area), 1.0, kMostParts))
             : 0;
}

/// The least area whose patches are not more than `most`, to 2^-40 or so: triangles of one area but
/// for rounding are cut alike.
double patch_area(std::span<const CutTriangle> triangles, std::size_t most) {
  double sum = 0.0;
  for (const CutTriangle& triangle : triangles) {
    sum += triangle.area_mm2;
  }
  const auto is_enough = [&](double area) {
    std::size_t n = 0;
    for (const CutTriangle& triangle : triangles) {
      const auto parts = static_cast<std::size_t>(parts_of(triangle, area));
      n += parts * parts;
    }
    return n <= most;
  };
  double high = sum;  // every triangle is one patch
  double low = sum / (2.0 * static_cast<double>(most));
  for (int step = 0; step < 40; ++step) {
    const double middle = std::sqrt(low * high);
    (is_enough(middle) ? high : low) = middle;
  }
  return high;
}

std::size_t vertices_of(int n) { return to_index((n + 1) * (n + 2) / 2); }

}  // namespace

std::size_t Patches::n_triangles(const Scene& scene) {
  std::size_t n = 0;
  for (const Mesh& mesh : scene.meshes) {
    n += mesh.triangles.size();
  }
  for (const Instance& instance : scene.instances) {
    n += scene.meshes[to_index(instance.mesh)].triangles.size();
  }
  return n;
}

Patches::Patches(const Scene& scene, std::size_t most) {
  HAARLIGHT_EXPECTS(most >= 1, "one patch at least");
  std::uint32_t surface = 0;
  for (const Mesh& mesh : scene.meshes) {
    first_of_surface_.emplace_back(triangles_.size());
    add_triangles(mesh, surface++, triangles_);
  }
  first_of_surface_.resize(first_of_surface_.size() + scene.spheres.size() +
                           scene.disks.size());
  surface += static_cast<std::uint32_t>(scene.spheres.size() + scene.disks.size());
  for (const Instance& instance : scene.instances) {
    first_of_surface_.emplace_back(triangles_.size());
    add_triangles(mesh_of(scene, instance), surface++, triangles_);
  }
  const double area = patch_area(triangles_, most);
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    CutTriangle& triangle = triangles_[t];
    triangle.n = parts_of(triangle, area);
    triangle.first_patch = n_patches_;
    triangle.first_vertex = n_vertices_;
    const std::size_t n = to_index(triangle.n) * to_index(triangle.n);
    triangle_of_patch_.insert(triangle_of_patch_.end(), n, static_cast<std::uint32_t>(t));
    n_patches_ += n;
    n_vertices_ += triangle.n > 0 ? vertices_of(triangle.n) : 0;
  }
}

const CutTriangle& Patches::triangle_of(std::size_t patch) const {
  return triangles_[triangle_of_patch_[patch]];
}

double Patches::area_mm2(std::size_t patch) const {
  const CutTriangle& triangle = triangle_of(patch);
  return triangle.area_mm2 / (static_cast<double>(triangle.n) * triangle.n);
}

// Row j has n - j patches that stand as the triangle does, and between them n - j - 1 upside down.
Vector2d Patches::uv_in(std::size_t patch, const Vector2d& square) const {
  const CutTriangle& triangle = triangle_of(patch);
  auto within = static_cast<int>(patch - triangle.first_patch);
  int j = 0;
  for (int in_row = 2 * triangle.n - 1; within >= in_row; in_row -= 2, ++j) {
    within -= in_row;
  }
  const int i = within / 2;
  const double root = std::sqrt(square.x());  // even on a triangle
  const Vector2d in_patch(root * (1.0 - square.y()), root * square.y());
  const Vector2d from(i, j);
  return (within % 2 == 0 ? Vector2d(from + in_patch)
                          : Vector2d(from + Vector2d::Ones() - in_patch)) /
         triangle.n;
}

PatchPoint Patches::find_in(const CutTriangle& triangle, const Vector2d& uv) {
  const int n = triangle.n;
  const double a = std::clamp(uv.x(), 0.0, 1.0) * n;
  const double b = std::clamp(uv.y(), 0.0, 1.0) * n;
  const int j = std::min(static_cast<int>(b), n - 1);
  const int i = std::min(static_cast<int>(a), n - 1 - j);
  const double x = std::min(a - i, 1.0);
  const double y = std::min(b - j, 1.0);
  const bool is_upside_down = x + y > 1.0 && i + j < n - 1;
  PatchPoint found;
  found.patch = patch_of(triangle, i, j, is_upside_down);
  const auto vertex = [&](int of_second, int of_third) {
    return triangle.vertex(of_second, of_third);
  };
  if (is_upside_down) {
    found.vertices = {vertex(i + 1, j + 1), vertex(i, j + 1), vertex(i + 1, j)};
    found.weights = {x + y - 1.0, 1.0 - x, 1.0 - y};
  } else {
    // x + y may be above 1 beyond the triangle's edge, by rounding.
    const double sum = std::max(1.0, x + y);
    found.vertices = {vertex(i, j), vertex(i + 1, j), vertex(i, j + 1)};
    found.weights = {1.0 - (x + y) / sum, x / sum, y / sum};
  }
  return found;
}

std::optional<PatchPoint> Patches::find(const RawHit& hit) const {
  const std::optional<std::size_t> first = first_of_surface_[hit.mesh];
  if (!first) {
    return std::nullopt;
  }
  const CutTriangle& triangle = triangles_[*first + hit.triangle];
  if (triangle.n == 0) {
    return std::nullopt;
  }
  return find_in(triangle, {hit.u, hit.v});
}

}  // namespace haarlight::render
