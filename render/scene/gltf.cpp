// SPDX-License-Identifier: Apache-2.0
/// @file
/// Scenes of glTF 2.0 [Gltf21]: nodes, and what stands at them.

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/scene/camera_table.h"
#include "render/scene/gltf_camera.h"
#include "render/scene/gltf_document.h"
#include "render/scene/gltf_light.h"
#include "render/scene/gltf_material.h"
#include "render/scene/gltf_mesh.h"
#include "render/scene/gltf_values.h"
#include "render/scene/gltf_warnings.h"

namespace haarlight::render {

namespace {

using Eigen::Affine3d;
using Eigen::Vector3d;

/// Metres to millimetres, y up to z up: (x, y, z) to (x, -z, y).
Affine3d world_from_gltf() {
  Affine3d world = Affine3d::Identity();
  world.linear() << kMillimetres, 0.0, 0.0,  //
      0.0, 0.0, -kMillimetres,               //
      0.0, kMillimetres, 0.0;
  return world;
}

/// A node's own: its matrix, or its translation * rotation * scale.
Affine3d local_of(const JsonValue& node) {
  Affine3d local = Affine3d::Identity();
  if (node.has("matrix")) {
    const std::array<double, 16> m = numbers_or<16>(node, "matrix", {});
    for (std::size_t i = 0; i < 16; ++i) {
      local.matrix()(static_cast<int>(i % 4), static_cast<int>(i / 4)) = m[i];
    }
    if ((local.matrix().row(3) - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).norm() > 1e-6) {
      node["matrix"].refuse("a matrix whose last row is not 0 0 0 1",
                            "write it by columns, without perspective");
    }
    return local;
  }
  const std::array<double, 3> t = numbers_or<3>(node, "translation", {0.0, 0.0, 0.0});
  const std::array<double, 4> r = numbers_or<4>(node, "rotation", {0.0, 0.0, 0.0, 1.0});
  const std::array<double, 3> s = numbers_or<3>(node, "scale", {1.0, 1.0, 1.0});
  const Eigen::Quaterniond turn(r[3], r[0], r[1], r[2]);
  if (!(turn.norm() > 1e-6 && turn.norm() < 1e6)) {
    node["rotation"].refuse("a rotation that is no quaternion: its length is not 1",
                            "write x, y, z, w of length 1");
  }
  local.translate(Vector3d(t[0], t[1], t[2]));
  local.rotate(turn.normalized());
  local.scale(Vector3d(s[0], s[1], s[2]));
  return local;
}

/// Whether what stands there can be moved elsewhere by a matrix.
bool has_inverse(const Affine3d& at) {
  const Eigen::Matrix3d& m = at.linear();
  return std::abs(m.determinant()) > 1e-9 * m.col(0).norm() * m.col(1).norm() * m.col(2).norm();
}

class GltfReader {
 public:
  GltfReader(std::string_view bytes, const std::string& name,
             const std::filesystem::path& folder, const GltfOptions& options)
      : document_(bytes, name, folder, kNumbersPerTriangle * options.max_triangles),
        options_(options),
        uses_(document_.meshes.size()) {}

  SceneFile read() {
    if (options_.has_materials) {
      read_materials();
    }
    walk();
    for (std::size_t m = 0; m < uses_.size(); ++m) {
      if (!uses_[m].empty()) {
        read_mesh(document_.meshes[m], uses_[m]);
      }
    }
    if (file_.scene.meshes.empty()) {
      throw Error("the scene shows no triangles", document_.name(),
                  "export it with its meshes, as triangles");
    }
    warn_of_the_rest();
    file_.files = document_.files();
    return std::move(file_);
  }

 private:
  static constexpr std::size_t kNumbersPerTriangle = 16;

  struct Use {
    std::size_t node;
    Affine3d world;
  };

  void read_materials() {
    const JsonValue asset = document_.root()["asset"];
    // Blender's exporter writes its radiance as it is, and multiplies watts of lamps alone.
    const bool is_radiance = asset.has("generator") &&
                             asset["generator"].text().find("Blender") != std::string::npos;
    for (const JsonValue& json : document_.materials) {
      materials_.push_back(read_gltf_material(
          document_, json, is_radiance ? 1.0 : 1.0 / kLumensPerWatt, warnings_));
      file_.scene.materials.push_back(materials_.back().material);
    }
  }

  /// The nodes that the scene shows.
  [[nodiscard]] std::vector<JsonValue> roots() {
    if (document_.scenes.empty()) {
      throw Error("the file has no scene", document_.name(), "export a scene, not a library");
    }
    std::size_t shown = 0;
    if (document_.root().has("scene")) {
      shown = document_.number_of(document_.root()["scene"], document_.scenes);
    } else if (document_.scenes.size() > 1) {
      warnings_.add(
          "of several scenes, none of which is the file's default, the first is shown",
          "scenes");
    }
    const JsonValue& scene = document_.scenes[shown];
    return scene.has("nodes") ? scene["nodes"].elements() : std::vector<JsonValue>();
  }

  void walk() {
    std::vector<char> is_seen(document_.nodes.size(), 0);
    std::vector<std::pair<std::size_t, Affine3d>> open;
    const auto push = [&](const std::vector<JsonValue>& indices, const Affine3d& world) {
      for (std::size_t i = indices.size(); i-- > 0;) {
        const std::size_t node = document_.number_of(indices[i], document_.nodes);
        if (is_seen[node] != 0) {
          indices[i].refuse(fmt::format("nodes[{}] is in the scene twice: a circle, or a node "
                                        "under two others",
                                        node),
                            "export the scene again: a node has one place");
        }
        is_seen[node] = 1;
        open.emplace_back(node, world);
      }
    };
    push(roots(), world_from_gltf());
    while (!open.empty()) {
      const auto [number, parent] = open.back();
      open.pop_back();
      const JsonValue& node = document_.nodes[number];
      const Affine3d world = parent * local_of(node);
      if (!(world.matrix().cwiseAbs().maxCoeff() <= 1e15)) {
        node.refuse("it stands beyond all bounds, or is scaled beyond them",
                    "correct its transform, and those of the nodes above it");
      }
      read_node(number, node, world);
      if (node.has("children")) {
        push(node["children"].elements(), world);
      }
    }
  }

  void read_node(std::size_t number, const JsonValue& node, const Affine3d& world) {
    if (node.has("mesh")) {
      uses_[document_.number_of(node["mesh"], document_.meshes)].push_back({number, world});
    }
    if (node.has("skin")) {
      warnings_.add("a skin is left out: the mesh stands as it was modelled", place(node));
    }
    if (!options_.has_materials) {
      return;
    }
    if (node.has("camera")) {
      const JsonValue& camera =
          document_.cameras[document_.number_of(node["camera"], document_.cameras)];
      if (file_.has_camera) {
        warnings_.add("of several cameras the first is taken, not these", place(node));
      } else {
        set_gltf_camera(camera, world, file_);
      }
    }
    if (node.has("extensions") && node["extensions"].has("KHR_lights_punctual")) {
      const JsonValue light = node["extensions"]["KHR_lights_punctual"]["light"];
      add_gltf_light(document_.lights[document_.number_of(light, document_.lights)], world,
                     file_.scene);
    }
  }

  void read_mesh(const JsonValue& json, const std::vector<Use>& uses) {
    for (const JsonValue& primitive : json["primitives"].elements()) {
      const int material = material_of(primitive);
      const auto own = static_cast<std::size_t>(material);
      const GltfMaterial none;
      const GltfMaterial* const of = !options_.has_materials   ? nullptr
                                     : own < materials_.size() ? &materials_[own]
                                                               : &none;
      Mesh mesh = read_gltf_primitive(document_, primitive, of, warnings_);
      mesh.name = json.has("name") ? json["name"].text() : place(json);
      mesh.material = material;
      if (!mesh.triangles.empty()) {
        add(mesh, primitive, uses, of);
      }
    }
  }

  int material_of(const JsonValue& primitive) {
    if (!options_.has_materials) {
      return 0;
    }
    if (primitive.has("material")) {
      return static_cast<int>(document_.number_of(primitive["material"], document_.materials));
    }
    warnings_.add(
        "triangles without a material get glTF's default, a rough white metal: give them one",
        place(primitive));
    if (file_.scene.materials.size() == materials_.size()) {
      file_.scene.materials.push_back(default_gltf_material());
    }
    return static_cast<int>(materials_.size());
  }

  /// The first use is the mesh, the others are instances of it; where there is no inverse, meshes.
  void add(const Mesh& mesh, const JsonValue& primitive, const std::vector<Use>& uses,
           const GltfMaterial* material) {
    const bool is_instanced =
        std::ranges::all_of(uses, [](const Use& use) { return has_inverse(use.world); });
    const std::size_t first_mesh = file_.scene.meshes.size();
    for (const Use& use : uses) {
      if (&use != uses.data() && is_instanced) {
        add_instances(first_mesh, use.world * uses[0].world.inverse(), use);
      } else {
        add_placed(mesh, primitive, use, material);
      }
    }
  }

  void add_placed(Mesh mesh, const JsonValue& primitive, const Use& use,
                  const GltfMaterial* material) {
    require_room(mesh, primitive);
    const std::size_t n_flat = place_mesh(mesh, use.world);
    n_flat_ += n_flat;
    for (const Vector3d& v : mesh.vertices) {
      if (!(v.cwiseAbs().maxCoeff() <= kMaxLength)) {
        document_.nodes[use.node].refuse("its mesh reaches beyond 1e9 mm",
                                         "correct its transform, or the mesh");
      }
    }
    if (mesh.triangles.empty()) {
      return;
    }
    const bool emits = material != nullptr && material->material.emits.maxCoeff() > 0.0;
    if (emits && material->is_double_sided && !is_closed(mesh)) {
      Mesh back = back_of(mesh);
      require_room(back, primitive);
      file_.scene.meshes.push_back(std::move(mesh));
      file_.scene.meshes.push_back(std::move(back));
      return;
    }
    file_.scene.meshes.push_back(std::move(mesh));
  }

  void require_room(const Mesh& mesh, const JsonValue& primitive) {
    const std::size_t n = std::max(mesh.triangles.size(), mesh.vertices.size());
    if (n > options_.max_triangles - n_triangles_) {
      primitive.refuse("more than 2^26 triangles or vertices in the scene",
                       "make its meshes simpler");
    }
    n_triangles_ += n;
  }

  void add_instances(std::size_t first_mesh, const Affine3d& world_from_mesh, const Use& use) {
    for (std::size_t m = first_mesh; m < file_.scene.meshes.size(); ++m) {
      if (file_.scene.instances.size() == kMaxInstances) {
        document_.nodes[use.node].refuse("more than 2^20 nodes that show a mesh again",
                                         "join some of them to one mesh");
      }
      file_.scene.instances.push_back(
          {.mesh = static_cast<int>(m), .world_from_mesh = world_from_mesh});
    }
  }

  void warn_of_the_rest() {
    if (n_flat_ > 0) {
      warnings_.add(fmt::format("{} triangles without area are left out", n_flat_), "meshes");
    }
    if (document_.root().has("animations")) {
      warnings_.add("animations are left out: all stands as at rest", "animations");
    }
    for (const std::string& extension : document_.unknown_extensions()) {
      warnings_.add("extensions that are not read", extension);
    }
    warnings_.log(document_.name());
  }

  [[nodiscard]] std::string place(const JsonValue& json) const {
    return place_of(json, document_.name());
  }

  GltfDocument document_;
  GltfOptions options_;
  GltfWarnings warnings_;
  SceneFile file_;
  std::vector<GltfMaterial> materials_;
  std::vector<std::vector<Use>> uses_;  ///< of each mesh
  std::size_t n_triangles_ = 0;         ///< of file_, or vertices where they are more
  std::size_t n_flat_ = 0;
};

}  // namespace

SceneFile parse_gltf(std::string_view bytes, const std::string& name,
                     const std::filesystem::path& folder, const GltfOptions& options) {
  return GltfReader(bytes, name, folder, options).read();
}

bool is_gltf(const std::filesystem::path& path) {
  return path.extension() == ".glb" || path.extension() == ".gltf";
}

SceneFile read_gltf(const std::filesystem::path& path, const GltfOptions& options) {
  const MappedFile file(path);
  const std::filesystem::path folder = path.parent_path();
  return parse_gltf({reinterpret_cast<const char*>(file.bytes().data()), file.bytes().size()},
                    path.string(), folder.empty() ? "." : folder, options);
}

}  // namespace haarlight::render
