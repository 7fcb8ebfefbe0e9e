// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"

namespace haarlight::render::testing {

/// A pinhole in front of a square picture of `size` pixels. @param focal_px  1e6: it sees one spot
inline CameraModel square_camera(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                                 double focal_px, int size) {
  CameraModel model;
  model.width = size;
  model.height = size;
  model.world_from_cam = look_at(eye, target, Eigen::Vector3d(0.1, 1.0, 0.2));
  model.fx = focal_px;
  model.fy = focal_px;
  model.cx = 0.5 * size;
  model.cy = 0.5 * size;
  return model;
}

}  // namespace haarlight::render::testing
