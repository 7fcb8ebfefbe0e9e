// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "haarlight/core/rig/rig.h"
#include "haarlight/core/stack/stack_source.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// The twin of the published figures: cube32's camera at 128 x 128 pixels over a scene, its
/// stack in linear values.

namespace haarlight::bench {

/// A scene, the rig that sees it, and the unit of its stack.
struct Twin {
  Rig rig;
  render::Scene scene;
  double scale = 1.0;
};

/// The rig of the twin's figures: 128 x 128 pixels, 36 degrees.
[[nodiscard]] Rig twin_rig(const std::string& rig_file);

struct TwinStack {
  Twin twin;
  MemoryStack stack;
};
/// Rendered once; later calls read the transport cache.
[[nodiscard]] TwinStack render_twin(const std::string& rig_file, const std::string& scene_file);

}  // namespace haarlight::bench
