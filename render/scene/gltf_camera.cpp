// SPDX-License-Identifier: Apache-2.0
#include "render/scene/gltf_camera.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "render/scene/camera_table.h"
#include "render/scene/gltf_light.h"
#include "render/scene/gltf_values.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kMostMetres = kMaxLength / kMillimetres;

/// Sides of that ratio, the longer one kGltfLongerSide.
void set_size(CameraModel& camera, double aspect) {
  const auto side = [](double share) {
    return std::clamp(static_cast<int>(std::lround(share * kGltfLongerSide)), 1,
                      kGltfLongerSide);
  };
  camera.width = side(std::min(aspect, 1.0));
  camera.height = side(std::min(1.0 / aspect, 1.0));
  camera.cx = 0.5 * camera.width;
  camera.cy = 0.5 * camera.height;
}

}  // namespace

void set_gltf_camera(const JsonValue& json, const Eigen::Affine3d& to_world, SceneFile& file) {
  CameraModel& camera = file.camera;
  const bool is_perspective = json["type"].choice({"perspective", "orthographic"}) == 0;
  const JsonValue lens = json[is_perspective ? "perspective" : "orthographic"];
  constexpr double kMostAspect = 1e3;
  if (is_perspective) {
    const double aspect =
        number_or(lens, "aspectRatio", 4.0 / 3.0, {1.0 / kMostAspect, kMostAspect});
    const double angle = lens["yfov"].number(1e-5, 179.0 * std::numbers::pi / 180.0);
    set_size(camera, aspect);
    const double half = std::tan(0.5 * angle);
    camera.fy = 0.5 * camera.height / half;
    camera.fx = 0.5 * camera.width / (aspect * half);
  } else {
    const double half_width = std::abs(lens["xmag"].number(-kMostMetres, kMostMetres));
    const double half_height = std::abs(lens["ymag"].number(-kMostMetres, kMostMetres));
    if (!(half_width > 1e-9 && half_height > 1e-9 && half_width / half_height <= kMostAspect &&
          half_height / half_width <= kMostAspect)) {
      lens.refuse("an orthographic camera without width or height",
                  "give it xmag and ymag, half of what it sees");
    }
    set_size(camera, half_width / half_height);
    file.optics.pixel_mm =
        2.0 * kMillimetres * std::max(half_width / camera.width, half_height / camera.height);
  }
  file.optics.near_mm = kMillimetres * number_or(lens, "znear", 0.0, {0.0, kMostMetres});
  file.optics.far_mm = kMillimetres * number_or(lens, "zfar", 0.0, {0.0, kMostMetres});
  if (file.optics.far_mm > 0.0 && !(file.optics.near_mm < file.optics.far_mm)) {
    lens.refuse("the camera sees nothing: zfar is not farther than znear",
                "give zfar a larger number");
  }
  // It looks along -z of its node, y up; ours along z, y down. No scale, no mirror.
  const Vector3d forward = -to_world.linear().col(2).stableNormalized();
  const Vector3d right = forward.cross(to_world.linear().col(1)).stableNormalized();
  if (!(forward.squaredNorm() > 0.5 && right.squaredNorm() > 0.5)) {
    json.refuse("a camera whose node is scaled to nothing", "give its node another scale");
  }
  camera.world_from_cam.linear().col(0) = right;
  camera.world_from_cam.linear().col(1) = forward.cross(right);
  camera.world_from_cam.linear().col(2) = forward;
  camera.world_from_cam.translation() = to_world.translation();
  file.has_camera = true;
}

}  // namespace haarlight::render
