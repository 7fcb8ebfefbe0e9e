// SPDX-License-Identifier: Apache-2.0
#include "render/scene/camera_table.h"

#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr Range kPosition{.min = -kMaxLength, .max = kMaxLength};

Vector3d to_vector(const std::vector<double>& values) {
  return {values[0], values[1], values[2]};
}

/// By eye, target, up, and either an angle or a width. @return  whether there is such a view
bool read_look_at(ConfigTable& table, CameraModel& camera, CameraOptics& optics) {
  const Vector3d eye = to_vector(table.numbers("eye", 3, kPosition));
  const Vector3d target = to_vector(table.numbers("target", 3, kPosition));
  const Vector3d up = to_vector(table.numbers_or("up", {0.0, 0.0, 1.0}, kPosition));
  if (!((target - eye).cross(up).norm() > 1e-9 * (target - eye).norm() * up.norm())) {
    table.problem("up", "the camera looks along its own up direction", "choose another up");
    return false;
  }
  camera.world_from_cam = look_at(eye, target, up);
  if (table.has("width_mm")) {
    optics.pixel_mm = table.number("width_mm", {.min = 1e-6, .max = kMaxLength}) / camera.width;
  } else {
    const double fov_deg = table.number("fov_y_deg", {.min = 1e-3, .max = 179.0});
    camera.fy = 0.5 * camera.height / std::tan(0.5 * fov_deg * std::numbers::pi / 180.0);
    camera.fx = camera.fy;
  }
  camera.cx = 0.5 * camera.width;
  camera.cy = 0.5 * camera.height;
  return true;
}

/// By K and world_from_cam.
void read_matrices(ConfigTable& table, CameraModel& camera) {
  const std::vector<double> k = table.matrix("K", 3, 3, {.min = -1e9, .max = 1e9});
  const std::vector<double> pose = table.matrix("world_from_cam", 3, 4, kPosition);
  camera.fx = k[0];
  camera.fy = k[4];
  camera.cx = k[2];
  camera.cy = k[5];
  for (int row = 0; row < 3; ++row) {
    for (int col = 0; col < 4; ++col) {
      camera.world_from_cam.matrix()(row, col) =
          pose[4U * static_cast<std::size_t>(row) + static_cast<std::size_t>(col)];
    }
  }
  const Eigen::Matrix3d r = camera.world_from_cam.linear();
  if (!(camera.fx > 0.0 && camera.fy > 0.0)) {
    table.problem("K", "focal lengths must be positive",
                  "K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]");
  }
  if (!((r.transpose() * r - Eigen::Matrix3d::Identity()).norm() < 1e-6) ||
      !(r.determinant() > 0.0)) {
    table.problem("world_from_cam", "its 3 x 3 part is no rotation",
                  "columns: the camera's right, down and forward in the world");
  }
}

/// near_mm and far_mm of a camera.
void read_clip(ConfigTable& table, CameraOptics& optics) {
  optics.near_mm = table.number_or("near_mm", 0.0, {.min = 0.0, .max = kMaxLength});
  optics.far_mm = table.number_or("far_mm", 0.0, {.min = 0.0, .max = kMaxLength});
  if (optics.far_mm > 0.0 && !(optics.near_mm < optics.far_mm)) {
    table.problem("far_mm",
                  fmt::format("the camera sees nothing: near_mm = {} is not nearer than "
                              "far_mm = {}",
                              optics.near_mm, optics.far_mm),
                  "give far_mm a larger number, or leave it out: no limit");
  }
}

}  // namespace

std::optional<std::array<int, 2>> picture_size_of(ConfigTable& table) {
  const std::vector<double> size = table.numbers("size", 2);
  for (const double pixels : size) {
    if (!(pixels >= 1.0 && pixels <= kMaxPictureSide) || pixels != std::floor(pixels)) {
      table.problem("size", "a picture's size is two whole numbers from 1 to 65536",
                    "size = [width, height]");
      return std::nullopt;
    }
  }
  return std::array{static_cast<int>(size[0]), static_cast<int>(size[1])};
}

std::optional<CameraTable> read_camera_table(ConfigTable& table) {
  const std::optional<std::array<int, 2>> size = picture_size_of(table);
  if (!size) {
    return std::nullopt;
  }
  CameraTable read;
  CameraModel& camera = read.camera;
  CameraOptics& optics = read.optics;
  camera.width = (*size)[0];
  camera.height = (*size)[1];
  if (!table.has("eye")) {
    read_matrices(table, camera);
  } else if (!read_look_at(table, camera, optics)) {
    return std::nullopt;
  }
  if (table.has("dist")) {
    const std::vector<double> dist = table.numbers("dist", 5, {.min = -1e3, .max = 1e3});
    for (int i = 0; i < 5; ++i) {
      camera.distortion[i] = dist[static_cast<std::size_t>(i)];
    }
  }
  if (table.has("lens_radius_mm")) {
    if (optics.pixel_mm > 0.0) {
      table.problem("lens_radius_mm", "an orthographic camera has no lens",
                    "leave it out, or give fov_y_deg instead of width_mm");
    }
    optics.lens_radius_mm = table.number("lens_radius_mm", {.min = 0.0, .max = kMaxLength});
    optics.focus_mm = table.number("focus_mm", {.min = 1e-6, .max = kMaxLength});
  }
  read_clip(table, optics);
  return read;
}

std::vector<CameraTable> read_cameras(const std::filesystem::path& path) {
  ConfigTable root = ConfigTable::parse_file(path);
  root.integer_or("schema", 1, {.min = 1, .max = 1});
  std::vector<CameraTable> cameras;
  std::vector<ConfigTable> tables = root.tables("camera");
  for (ConfigTable& table : tables) {
    if (const std::optional<CameraTable> read = read_camera_table(table)) {
      cameras.push_back(*read);
    }
  }
  if (tables.empty() || tables.size() > kMaxCameras) {
    root.problem("camera",
                 fmt::format("{} cameras; a file has from 1 to {}", tables.size(), kMaxCameras),
                 "give each picture a [[camera]] with the keys of a scene file's [camera]");
  }
  root.finish();
  return cameras;
}

}  // namespace haarlight::render
