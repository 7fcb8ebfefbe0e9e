// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_mesh.h"

#include <algorithm>
#include <array>
#include <map>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/scene/camera_table.h"
#include "render/scene/gltf_values.h"

namespace haarlight::render {

namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr const char* kRepair =
    "repair the mesh in the program that made it, and export it again";

// Modes of primitives.
constexpr int kLastOfLines = 3;
constexpr int kTriangles = 4;
constexpr int kFan = 6;

Vector3d vector_of(const GltfNumbers& numbers, std::size_t i) {
  return {numbers(i, 0), numbers(i, 1), numbers(i, 2)};
}

/// The corners, one after the other, of all triangles.
std::vector<int> corners_of(GltfDocument& document, const JsonValue& primitive,
                            std::size_t n_vertices) {
  std::vector<int> corners;
  if (!primitive.has("indices")) {
    corners.resize(n_vertices);
    for (std::size_t i = 0; i < n_vertices; ++i) {
      corners[i] = static_cast<int>(i);
    }
    return corners;
  }
  const GltfNumbers indices = document.numbers(primitive["indices"], "SCALAR");
  corners.reserve(indices.count);
  for (std::size_t i = 0; i < indices.count; ++i) {
    const double index = indices(i, 0);
    if (!(index >= 0.0 && index < static_cast<double>(n_vertices))) {
      primitive["indices"].refuse(
          fmt::format("its index {} is {}, of {} vertices", i, index, n_vertices), kRepair);
    }
    corners.push_back(static_cast<int>(index));
  }
  return corners;
}

std::vector<Vector3i> triangles_of(const JsonValue& primitive, const std::vector<int>& corners,
                                   int mode) {
  std::vector<Vector3i> triangles;
  if (mode == kTriangles) {
    if (corners.size() % 3 != 0) {
      primitive.refuse(fmt::format("{} corners, not a multiple of 3", corners.size()), kRepair);
    }
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3) {
      triangles.emplace_back(corners[i], corners[i + 1], corners[i + 2]);
    }
    return triangles;
  }
  for (std::size_t i = 0; i + 2 < corners.size(); ++i) {
    if (mode == kFan) {
      triangles.emplace_back(corners[i + 1], corners[i + 2], corners[0]);
    } else {
      triangles.emplace_back(corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]);
    }
  }
  return triangles;
}

Vector3d twice_area(const Mesh& mesh, const Vector3i& t) {
  const auto at = [&](int c) -> const Vector3d& {
    return mesh.vertices[static_cast<std::size_t>(t[c])];
  };
  return (at(1) - at(0)).cross(at(2) - at(0));
}

/// Numbers of an attribute, as many as there are vertices.
GltfNumbers attribute(GltfDocument& document, const JsonValue& attributes,
                      std::string_view name, std::string_view type, std::size_t n_vertices) {
  GltfNumbers numbers = document.numbers(attributes[name], type);
  if (numbers.count != n_vertices) {
    attributes[name].refuse(
        fmt::format("{} elements, for {} vertices", numbers.count, n_vertices), kRepair);
  }
  return numbers;
}

void read_normals(GltfDocument& document, const JsonValue& attributes, Mesh& mesh) {
  const GltfNumbers normals =
      attribute(document, attributes, "NORMAL", "VEC3", mesh.vertices.size());
  mesh.normals.reserve(normals.count);
  std::size_t n_missing = 0;
  for (std::size_t i = 0; i < normals.count; ++i) {
    mesh.normals.push_back(vector_of(normals, i).stableNormalized());
    n_missing += mesh.normals.back().squaredNorm() > 0.5 ? 0 : 1;
  }
  if (n_missing == 0) {
    return;
  }
  for (const Vector3i& t : mesh.triangles) {  // of one of its triangles instead
    for (const int corner : t) {
      Vector3d& normal = mesh.normals[static_cast<std::size_t>(corner)];
      if (!(normal.squaredNorm() > 0.5)) {
        normal = twice_area(mesh, t).stableNormalized();
      }
    }
  }
  for (Vector3d& normal : mesh.normals) {
    normal =
        normal.squaredNorm() > 0.5 ? normal : Vector3d::UnitZ();  // of no triangle's corner
  }
}

void read_uvs(GltfDocument& document, const JsonValue& primitive, const GltfMaterial& material,
              Mesh& mesh, GltfWarnings& warnings) {
  const JsonValue attributes = primitive["attributes"];
  if (!attributes.has(material.uv_attribute)) {
    attributes.refuse(fmt::format("no {}, by which material '{}' has its texture",
                                  material.uv_attribute, material.material.name),
                      "give the mesh a UV map, or the material no texture");
  }
  const GltfNumbers uvs =
      attribute(document, attributes, material.uv_attribute, "VEC2", mesh.vertices.size());
  bool is_beyond = false;
  mesh.uvs.reserve(uvs.count);
  for (std::size_t i = 0; i < uvs.count; ++i) {
    const Vector2d uv = material.uv_transform * Vector2d(uvs(i, 0), uvs(i, 1));
    mesh.uvs.emplace_back(uv.x(), 1.0 - uv.y());  // v goes down in glTF
    is_beyond = is_beyond || uv.minCoeff() < 0.0 || uv.maxCoeff() > 1.0;
    if (!(mesh.uvs.back().cwiseAbs().maxCoeff() <= kMaxUv)) {
      attributes[material.uv_attribute].refuse(
          fmt::format("the texture coordinates of vertex {} are beyond 1e9", i), kRepair);
    }
  }
  if (is_beyond && !material.is_repeated) {
    warnings.add("a texture repeats beyond its sides, where the file ends or mirrors it",
                 place_of(primitive, document.name()));
  }
}

}  // namespace

Mesh read_gltf_primitive(GltfDocument& document, const JsonValue& primitive,
                         const GltfMaterial* material, GltfWarnings& warnings) {
  const std::string place = place_of(primitive, document.name());
  const int mode =
      primitive.has("mode") ? static_cast<int>(primitive["mode"].integer(0, kFan)) : kTriangles;
  Mesh mesh;
  if (mode <= kLastOfLines) {
    warnings.add("points and lines are left out", place);
    return mesh;
  }
  const JsonValue attributes = primitive["attributes"];
  if (!attributes.has("POSITION")) {
    warnings.add("triangles without positions are left out", place);
    return mesh;
  }
  const GltfNumbers positions = document.numbers(attributes["POSITION"], "VEC3");
  if (positions.count > kMaxTriangles) {
    attributes["POSITION"].refuse("more than 2^26 vertices", "make the mesh smaller");
  }
  mesh.vertices.reserve(positions.count);
  for (std::size_t i = 0; i < positions.count; ++i) {
    mesh.vertices.push_back(vector_of(positions, i));
  }
  mesh.triangles =
      triangles_of(primitive, corners_of(document, primitive, positions.count), mode);
  if (attributes.has("NORMAL")) {
    read_normals(document, attributes, mesh);
  }
  if (material != nullptr && material->has_base_texture) {
    read_uvs(document, primitive, *material, mesh, warnings);
  } else if (material == nullptr && attributes.has("TEXCOORD_0")) {
    read_uvs(document, primitive, GltfMaterial{}, mesh, warnings);
  }
  if (material != nullptr && attributes.has("COLOR_0")) {
    warnings.add("colours of vertices are left out", place);
  }
  if (primitive.has("targets")) {
    warnings.add("morph targets are left out: the shape is the one without them", place);
  }
  return mesh;
}

std::size_t place_mesh(Mesh& mesh, const Eigen::Affine3d& to) {
  const Eigen::Matrix3d linear = to.linear();
  const bool is_mirrored = linear.determinant() < 0.0;
  // The inverse's transpose but for its length: also where there is no inverse.
  Eigen::Matrix3d for_normals;
  for (int c = 0; c < 3; ++c) {
    for_normals.col(c) = linear.col((c + 1) % 3).cross(linear.col((c + 2) % 3));
  }
  for (Vector3d& vertex : mesh.vertices) {
    vertex = to * vertex;
  }
  for (Vector3d& normal : mesh.normals) {
    const Vector3d turned = (for_normals * normal).stableNormalized() * (is_mirrored ? -1 : 1);
    normal = turned.squaredNorm() > 0.5 ? turned : normal;
  }
  if (is_mirrored) {
    for (Vector3i& t : mesh.triangles) {
      std::swap(t[1], t[2]);
    }
  }
  return std::erase_if(mesh.triangles, [&](const Vector3i& t) {
    return !(twice_area(mesh, t).squaredNorm() > 0.0);
  });
}

bool is_closed(const Mesh& mesh) {
  std::map<std::array<double, 3>, int> places;
  std::vector<int> place_of_vertex;
  place_of_vertex.reserve(mesh.vertices.size());
  for (const Vector3d& v : mesh.vertices) {
    place_of_vertex.push_back(
        places.emplace(std::array{v.x(), v.y(), v.z()}, static_cast<int>(places.size()))
            .first->second);
  }
  std::vector<std::pair<int, int>> sides;
  std::vector<std::pair<int, int>> turned;
  for (const Vector3i& t : mesh.triangles) {
    for (int c = 0; c < 3; ++c) {
      const int from = place_of_vertex[static_cast<std::size_t>(t[c])];
      const int to = place_of_vertex[static_cast<std::size_t>(t[(c + 1) % 3])];
      sides.emplace_back(from, to);
      turned.emplace_back(to, from);
    }
  }
  std::ranges::sort(sides);
  std::ranges::sort(turned);
  return sides == turned;
}

Mesh back_of(const Mesh& mesh) {
  Eigen::AlignedBox3d box;
  double reach = 0.0;  // of the coordinates: single precision must tell the sides apart
  for (const Vector3d& v : mesh.vertices) {
    box.extend(v);
    reach = std::max(reach, v.cwiseAbs().maxCoeff());
  }
  const double distance = 1e-5 * std::max(box.diagonal().norm(), 0.1 * reach);
  Mesh back{.name = mesh.name, .material = mesh.material};
  for (const Vector3i& t : mesh.triangles) {
    const Vector3d behind = -distance * twice_area(mesh, t).stableNormalized();
    const int first = static_cast<int>(back.vertices.size());
    for (const int c : {0, 2, 1}) {
      const auto corner = static_cast<std::size_t>(t[c]);
      back.vertices.emplace_back(mesh.vertices[corner] + behind);
      if (!mesh.normals.empty()) {
        back.normals.emplace_back(-mesh.normals[corner]);
      }
      if (!mesh.uvs.empty()) {
        back.uvs.push_back(mesh.uvs[corner]);
      }
    }
    back.triangles.emplace_back(first, first + 1, first + 2);
  }
  return back;
}

}  // namespace haarlight::render
