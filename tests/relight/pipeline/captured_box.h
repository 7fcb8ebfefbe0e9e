// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/files.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/render/scene/scene.h"
#include "tests/relight/pipeline/rendered_capture.h"
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
    return render_capture(rig_toml, render::read_scene(folder_ / "box.toml").scene);
  }

  /// Writes the basis file.
  void store(const std::string& name, const std::string& rig_toml, const MemoryStack& stack,
             relight::HaarGrid grid = {8, 8}) const {
    store_capture(folder_ / name, rig_toml, stack, grid);
  }

  TemporaryFolder folder_;
  std::string rig_;
};

}  // namespace haarlight::testing
