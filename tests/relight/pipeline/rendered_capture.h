// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/render/direct/direct_light.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"

/// @file
/// A scene over a rig's plane as a capture without noise.

namespace haarlight::testing {

/// One channel, light by light; the ground z = 0 is added, of kd 0.8.
inline MemoryStack render_capture(const std::string& rig_toml, render::Scene scene) {
  const Rig rig = parse_rig(rig_toml, "rig");
  const CameraModel& eye = rig.cameras[0].model;
  const std::vector<render::SquareLight> lights = render::rig_lights(rig);
  scene.materials.push_back({"plane", Eigen::Vector3d::Constant(0.8), 0.0, 1.0});
  scene.meshes.push_back(render::make_quad({-2000, -2000, 0}, {2000, -2000, 0}, {2000, 2000, 0},
                                           {-2000, 2000, 0},
                                           static_cast<int>(scene.materials.size()) - 1));
  const render::RayCaster caster(scene);
  const render::DirectLight direct(caster, lights);
  MemoryStack stack({eye.width, eye.height, 1, static_cast<int>(lights.size())});
  std::vector<render::LightContribution> contributions(lights.size());
  for (int y = 0; y < eye.height; ++y) {
    for (int x = 0; x < eye.width; ++x) {
      const auto seen = render::visible_surface(caster, eye, x + 0.5, y + 0.5);
      if (!seen) {
        continue;  // above the horizon
      }
      const render::Material& material =
          scene.materials[static_cast<std::size_t>(seen->material)];
      direct.evaluate(*seen, material, 1, contributions);
      for (std::size_t k = 0; k < lights.size(); ++k) {
        stack.at(0, y, x, static_cast<int>(k)) =
            static_cast<float>(1e6 * material.kd.x() * contributions[k].diffuse);
      }
    }
  }
  return stack;
}

/// Writes it as a basis file of relative L2 error 1e-3.
inline void store_capture(const std::filesystem::path& file, const std::string& rig_toml,
                          const MemoryStack& stack, relight::HaarGrid grid) {
  relight::CompressSource source;
  source.stack = &stack;
  source.rig_toml = rig_toml;
  source.grid = grid;
  source.name = file.filename().string();
  relight::CompressOptions compress;
  compress.relative_l2 = 1e-3;
  (void)relight::compress_stack(source, file, compress);
}

}  // namespace haarlight::testing
