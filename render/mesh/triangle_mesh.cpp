// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/mesh/triangle_mesh.h"

#include <array>
#include <cmath>
#include <map>
#include <mutex>
#include <numbers>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "haarlight/core/error.h"

namespace haarlight::render {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3i;

Mesh make_box(const Vector3d& low, const Vector3d& high, int material) {
  Mesh mesh;
  mesh.name = "box";
  mesh.material = material;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.emplace_back((i & 1) != 0 ? high.x() : low.x(),
                               (i & 2) != 0 ? high.y() : low.y(),
                               (i & 4) != 0 ? high.z() : low.z());
  }
  // Counter-clockwise from outside: bottom, top, front, back, left, right.
  constexpr std::array<std::array<int, 4>, 6> kQuads = {
      {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}}};
  for (const auto& q : kQuads) {
    mesh.triangles.emplace_back(q[0], q[1], q[2]);
    mesh.triangles.emplace_back(q[0], q[2], q[3]);
  }
  return mesh;
}

Mesh make_textured_box(const Vector3d& low, const Vector3d& high, int material) {
  const Mesh plain = make_box(low, high, material);
  // u and v of each side, by its corners' order in make_box.
  const auto uv_of = [&](std::size_t side, const Vector3d& at) -> Vector2d {
    const Vector3d s = (at - low).cwiseQuotient(high - low);
    switch (side) {
      case 0:
        return {s.x(), 1.0 - s.y()};
      case 1:
        return {s.x(), s.y()};
      case 2:
        return {s.x(), s.z()};
      case 3:
        return {1.0 - s.x(), s.z()};
      case 4:
        return {1.0 - s.y(), s.z()};
      default:
        return {s.y(), s.z()};
    }
  };
  Mesh mesh;
  mesh.name = plain.name;
  mesh.material = material;
  for (std::size_t side = 0; side < 6; ++side) {
    const Vector3i& first = plain.triangles[2 * side];
    const int last = plain.triangles[2 * side + 1][2];
    const int n = static_cast<int>(mesh.vertices.size());
    for (const int corner : {first[0], first[1], first[2], last}) {
      mesh.vertices.push_back(plain.vertices[static_cast<std::size_t>(corner)]);
      mesh.uvs.push_back(uv_of(side, mesh.vertices.back()));
    }
    mesh.triangles.emplace_back(n, n + 1, n + 2);
    mesh.triangles.emplace_back(n, n + 2, n + 3);
  }
  return mesh;
}

namespace {

struct UnitSphere {
  std::vector<Vector3d> directions;
  std::vector<Vector3i> triangles;
};

/// An octahedron, every triangle split in four `n_subdivisions` times, vertices on the sphere.
UnitSphere make_unit_sphere(int n_subdivisions) {
  std::vector<Vector3d> directions = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                      {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
  std::vector<Vector3i> triangles = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                     {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < n_subdivisions; ++level) {
    std::map<std::pair<int, int>, int> middles;
    const auto middle = [&](int a, int b) {
      const auto [position, is_new] = middles.try_emplace(std::minmax(a, b), 0);
      if (is_new) {
        position->second = static_cast<int>(directions.size());
        directions.emplace_back(
            (directions[static_cast<std::size_t>(a)] + directions[static_cast<std::size_t>(b)])
                .normalized());
      }
      return position->second;
    };
    std::vector<Vector3i> finer;
    finer.reserve(triangles.size() * 4);
    for (const Vector3i& t : triangles) {
      const int ab = middle(t[0], t[1]);
      const int bc = middle(t[1], t[2]);
      const int ca = middle(t[2], t[0]);
      finer.emplace_back(t[0], ab, ca);
      finer.emplace_back(ab, t[1], bc);
      finer.emplace_back(ca, bc, t[2]);
      finer.emplace_back(ab, bc, ca);
    }
    triangles = std::move(finer);
  }
  return {.directions = std::move(directions), .triangles = std::move(triangles)};
}

constexpr int kMostSubdivisions = 8;

/// Each is made once, when it is first needed: a scene may have thousands.
const UnitSphere& unit_sphere(int n_subdivisions) {
  static std::array<std::once_flag, kMostSubdivisions + 1> is_made;
  static std::array<UnitSphere, kMostSubdivisions + 1> spheres;
  const auto level = static_cast<std::size_t>(n_subdivisions);
  std::call_once(is_made.at(level),
                 [&] { spheres.at(level) = make_unit_sphere(n_subdivisions); });
  return spheres.at(level);
}

}  // namespace

Mesh make_sphere(const Vector3d& centre, double radius_mm, int n_subdivisions, int material) {
  HAARLIGHT_EXPECTS(n_subdivisions >= 0 && n_subdivisions <= kMostSubdivisions,
                    "0 to 8 subdivisions");
  const UnitSphere& unit = unit_sphere(n_subdivisions);
  Mesh mesh;
  mesh.name = "sphere";
  mesh.material = material;
  mesh.triangles = unit.triangles;
  mesh.normals = unit.directions;
  mesh.vertices.reserve(unit.directions.size());
  for (const Vector3d& direction : unit.directions) {
    mesh.vertices.emplace_back(centre + radius_mm * direction);
  }
  return mesh;
}

Vector2d sphere_uv(const Vector3d& direction) {
  const double turn =
      std::atan2(direction.y(), direction.x()) / (2.0 * std::numbers::pi);  // -1/2 to 1/2
  const double u = turn < 0.0 ? turn + 1.0 : turn;
  // By both coordinates: the cosine alone would lose half its digits near a pole.
  const double across = std::hypot(direction.x(), direction.y());
  return {u < 1.0 ? u : 0.0, std::atan2(across, -direction.z()) / std::numbers::pi};
}

Mesh make_textured_sphere(const Vector3d& centre, double radius_mm, int n_subdivisions,
                          int material) {
  Mesh mesh = make_sphere(centre, radius_mm, n_subdivisions, material);
  mesh.uvs.reserve(mesh.normals.size());
  for (const Vector3d& direction : mesh.normals) {
    mesh.uvs.push_back(sphere_uv(direction));
  }
  const auto copy = [&mesh](int index, double u) {
    const auto i = static_cast<std::size_t>(index);
    const Vector3d vertex = mesh.vertices[i];  // the list may move
    const Vector3d normal = mesh.normals[i];
    mesh.vertices.push_back(vertex);
    mesh.normals.push_back(normal);
    mesh.uvs.emplace_back(u, mesh.uvs[i].y());
    return static_cast<int>(mesh.uvs.size()) - 1;
  };
  const auto uv = [&mesh](int i) -> const Vector2d& {
    return mesh.uvs[static_cast<std::size_t>(i)];
  };
  const auto is_pole = [&mesh](int i) {
    const Vector3d& n = mesh.normals[static_cast<std::size_t>(i)];
    return n.x() == 0.0 && n.y() == 0.0;
  };
  std::map<int, int> beyond_seam;  // the copy with u = 1 of a vertex with u = 0
  for (Vector3i& t : mesh.triangles) {
    // The octahedron's edges are on the seam, so that a triangle is on one side of it.
    const bool is_last_quarter = uv(t[0]).x() > 0.5 || uv(t[1]).x() > 0.5 || uv(t[2]).x() > 0.5;
    for (int& i : t) {
      if (is_last_quarter && !is_pole(i) && uv(i).x() == 0.0) {
        const auto [found, is_new] = beyond_seam.try_emplace(i, 0);
        if (is_new) {
          found->second = copy(i, 1.0);
        }
        i = found->second;
      }
    }
    for (int c = 0; c < 3; ++c) {
      if (is_pole(t[c])) {
        t[c] = copy(t[c], 0.5 * (uv(t[(c + 1) % 3]).x() + uv(t[(c + 2) % 3]).x()));
      }
    }
  }
  return mesh;
}

Mesh make_quad(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d,
               int material) {
  Mesh mesh;
  mesh.name = "quad";
  mesh.material = material;
  mesh.vertices = {a, b, c, d};
  mesh.uvs = {{0.0, 0.0}, {1.0, 0.0}, {1.0, 1.0}, {0.0, 1.0}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

}  // namespace haarlight::render
