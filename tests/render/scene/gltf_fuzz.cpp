// SPDX-License-Identifier: Apache-2.0
/// @file
/// Fuzz target: bytes as a .glb or .gltf either read as a sound scene or throw Error.

#include "tests/render/scene/mesh_fuzz.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  namespace render = haarlight::render;
  haarlight::test::read_or_refuse(
      [](std::string_view bytes) {
        const render::SceneFile file =
            render::parse_gltf(bytes, "fuzz.glb", {}, {.max_triangles = 1U << 18U});
        for (const render::Instance& instance : file.scene.instances) {
          HAARLIGHT_EXPECTS(instance.mesh >= 0 &&
                                instance.mesh < static_cast<int>(file.scene.meshes.size()) &&
                                instance.world_from_mesh.matrix().allFinite(),
                            "a mesh of the scene, somewhere");
        }
        for (const render::PointLight& light : file.scene.point_lights) {
          HAARLIGHT_EXPECTS(light.position.allFinite() && light.intensity.allFinite() &&
                                light.intensity.minCoeff() >= 0.0 && light.axis.allFinite(),
                            "a lamp that can shine");
        }
        for (const render::Material& material : file.scene.materials) {
          HAARLIGHT_EXPECTS(material.kd.allFinite() && material.eta.allFinite() &&
                                material.k.allFinite() && material.roughness > 0.0,
                            "a surface that can scatter");
        }
        if (file.has_camera) {
          HAARLIGHT_EXPECTS(file.camera.world_from_cam.matrix().allFinite() &&
                                file.camera.width > 0 && file.camera.height > 0,
                            "a camera that sees");
        }
        return file.scene;
      },
      data, size);
  return 0;
}
