// SPDX-License-Identifier: Apache-2.0
/// @file
/// Any bytes as a scene file: a scene or an Error.

#include <cstdint>

#include "core/log.h"
#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene.h"
#include "tests/memory_file.h"
#include "tests/repeating_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  haarlight::set_log_level(haarlight::LogLevel::off);
  const haarlight::testing::MemoryFile file(data, size);
  try {
    const haarlight::render::SceneFile scene = haarlight::render::read_scene(file.path());
    for (const haarlight::render::Mesh& mesh : scene.scene.meshes) {
      HAARLIGHT_EXPECTS(
          mesh.material >= 0 && mesh.material < static_cast<int>(scene.scene.materials.size()),
          "a material of the scene");
    }
    for (const haarlight::render::Instance& instance : scene.scene.instances) {
      HAARLIGHT_EXPECTS(instance.mesh >= 0 &&
                            instance.mesh < static_cast<int>(scene.scene.meshes.size()) &&
                            instance.world_from_mesh.matrix().allFinite(),
                        "a mesh of the scene, somewhere");
    }
  } catch (const haarlight::Error&) {  // NOLINT(bugprone-empty-catch): refused
  }
  return 0;
}
