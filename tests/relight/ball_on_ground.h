// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/rig/rig.h"
#include "haarlight/render/scene/scene.h"

/// @file
/// A glossy ball on a plane, under 8 x 8 lights, seen by a camera of few pixels.

namespace haarlight::test {

inline Rig rig_of_64_lights(int width, int height) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  CameraModel& camera = rig.cameras[0].model;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 87.9192774 * width / 64.0;
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  return rig;
}

inline render::Scene glossy_ball_on_ground() {
  render::Scene scene;
  scene.materials.push_back({"ground", Eigen::Vector3d::Constant(0.8), 0.0, 1.0});
  scene.materials.push_back({"ball", Eigen::Vector3d(0.2, 0.3, 0.4), 0.5, 60.0});
  scene.meshes.push_back(render::make_quad({-1000, -1000, 0}, {1000, -1000, 0}, {1000, 1000, 0},
                                           {-1000, 1000, 0}, 0));
  scene.meshes.push_back(render::make_sphere({20, 0, 80}, 45.0, 4, 1));
  return scene;
}

}  // namespace haarlight::test
