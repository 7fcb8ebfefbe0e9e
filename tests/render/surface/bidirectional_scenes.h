// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

#include "haarlight/core/rig/camera_model.h"
#include "haarlight/render/light/cubemap.h"
#include "haarlight/render/scene/scene.h"
#include "render/loop/tile_renderer.h"
#include "render/surface/bidirectional_integrator.h"
#include "render/surface/path_integrator.h"

/// @file
/// Scenes and means for the tests of bidirectional path tracing.

namespace haarlight::render::testing {

inline constexpr int kBidirectionalSize = 16;

/// A picture's mean over all pixels, and that mean's standard error.
struct PictureMean {
  Eigen::Vector3d value = Eigen::Vector3d::Zero();
  Eigen::Vector3d error = Eigen::Vector3d::Zero();
};

/// One integrator in one scene: replicates with other seeds, as many as their differences need to
/// tell the error of their mean.
struct Rendering {
  const Scene* scene = nullptr;
  CameraModel model;
  CameraOptics optics;
  const Environment* environment = nullptr;
  std::uint32_t samples = 32;
  int replicates = 16;
};
[[nodiscard]] PictureMean mean_of_paths(const Rendering& rendering, PathOptions options);
/// Of paths of just that many bounces: of each replicate all with as many, less all with fewer.
[[nodiscard]] PictureMean mean_of_paths_of(const Rendering& rendering, PathOptions options,
                                           int bounces);
[[nodiscard]] PictureMean mean_of_bidirectional(const Rendering& rendering,
                                                BidirectionalOptions options);

/// An open room of matte, glossy and smoothly shaded surfaces, all lit indirectly, too, under a lamp.
[[nodiscard]] Scene room();
[[nodiscard]] CameraModel room_camera();

}  // namespace haarlight::render::testing
