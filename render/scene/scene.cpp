// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/scene/scene.h"

namespace haarlight::render {

void append_scene(Scene& scene, const Scene& added) {
  const int first_material = static_cast<int>(scene.materials.size());
  scene.materials.insert(scene.materials.end(), added.materials.begin(), added.materials.end());
  for (const Mesh& mesh : added.meshes) {
    scene.meshes.push_back(mesh);
    scene.meshes.back().material += first_material;
  }
  scene.lights.insert(scene.lights.end(), added.lights.begin(), added.lights.end());
}

}  // namespace haarlight::render
