// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/files.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/render/direct_light.h"
#include "haarlight/render/picture.h"
#include "haarlight/render/rig_lights.h"
#include "tests/temporary_folder.h"

/// @file
/// A box over the plane of configs/rigs/small8.toml, rendered without noise as a capture.

namespace haarlight::testing {

inline const char* const kBox =
    "schema = 1\nname = \"box\"\n[[material]]\nname = \"m\"\nkd = [0.3]\n"
    "[[box]]\nlow = [-30.0, -30.0, 20.0]\nhigh = [30.0, 30.0, 80.0]\nmaterial = \"m\"\n";

inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

class CapturedBox : public ::testing::Test {
 protected:
  CapturedBox() {
    write_file_atomically(folder_ / "box.toml", kBox);
    rig_ = replaced(read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"), "texel = 2.0",
                    "texel = 4.0");
  }

  /// The box over the rig's plane, without noise.
  void capture(const std::string& name, const std::string& rig_toml) const {
    store(name, rig_toml, render(rig_toml));
  }

  /// One channel, light by light.
  [[nodiscard]] MemoryStack render(const std::string& rig_toml) const {
    const Rig rig = parse_rig(rig_toml, "rig");
    const CameraModel& eye = rig.cameras[0].model;
    const std::vector<render::SquareLight> lights = render::rig_lights(rig);
    render::Scene scene = render::read_scene(folder_ / "box.toml").scene;
    scene.materials.push_back({"plane", Eigen::Vector3d::Constant(0.8), 0.0, 1.0});
    scene.meshes.push_back(render::make_quad({-2000, -2000, 0}, {2000, -2000, 0},
                                             {2000, 2000, 0}, {-2000, 2000, 0}, 1));
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

  /// Writes the basis file.
  void store(const std::string& name, const std::string& rig_toml, const MemoryStack& stack,
             relight::HaarGrid grid = {8, 8}) const {
    relight::CompressSource source;
    source.stack = &stack;
    source.rig_toml = rig_toml;
    source.grid = grid;
    source.name = name;
    relight::CompressOptions compress;
    compress.relative_l2 = 1e-3;
    (void)relight::compress_stack(source, folder_ / name, compress);
  }

  TemporaryFolder folder_;
  std::string rig_;
};

}  // namespace haarlight::testing
