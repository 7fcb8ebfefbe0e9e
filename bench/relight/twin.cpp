// SPDX-License-Identifier: Apache-2.0
#include "bench/relight/twin.h"

#include <cmath>
#include <numbers>

#include "haarlight/render/light/rig_lights.h"
#include "sim/transport.h"

namespace haarlight::bench {

namespace {

MemoryStack stack_of(const sim::Transport& transport, double scale) {
  MemoryStack stack({transport.width(), transport.height(), 1, transport.n_lights()});
  for (int k = 0; k < transport.n_lights(); ++k) {
    const ImageView<const float> plane = transport.plane(k);
    for (int y = 0; y < transport.height(); ++y) {
      for (int x = 0; x < transport.width(); ++x) {
        stack.at(0, y, x, k) = static_cast<float>(double{plane(y, x)} / scale);
      }
    }
  }
  return stack;
}

}  // namespace

Rig twin_rig(const std::string& rig_file) {
  constexpr int kSize = 128;
  const double focal = 0.5 * kSize / std::tan(0.5 * 36.0 * std::numbers::pi / 180.0);
  Rig rig = read_rig(rig_file);
  CameraModel& camera = rig.cameras.front().model;
  camera.width = camera.height = kSize;
  camera.fx = camera.fy = focal;
  camera.cx = camera.cy = 0.5 * kSize;
  camera.world_from_cam = look_at({0, -560, 520}, {0, 5, 45}, {0, 0, 1});
  return rig;
}

TwinStack render_twin(const std::string& rig_file, const std::string& scene_file) {
  Rig rig = twin_rig(rig_file);
  render::Scene scene =
      render::with_instances_expanded(render::read_scene(scene_file).scene, scene_file);
  const sim::Transport transport = sim::make_transport(rig, 0, scene, sim::TransportOptions{});
  MemoryStack stack = stack_of(transport, transport.scale());
  return {Twin{std::move(rig), std::move(scene), transport.scale()}, std::move(stack)};
}

}  // namespace haarlight::bench
