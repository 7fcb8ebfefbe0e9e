// SPDX-License-Identifier: Apache-2.0
#include "session/transforms_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "core/json_value.h"
#include "haarlight/core/error.h"

namespace haarlight::session {

namespace {

constexpr double kMostLength = 1e9;
constexpr double kRotationSlack = 1e-3;  // such files are printed with 4 to 16 digits

Eigen::Vector3d vector_of(const JsonValue& list) {
  const std::vector<JsonValue> numbers = list.elements();
  if (numbers.size() != 3) {
    list.refuse(fmt::format("{} numbers", numbers.size()), "write [x, y, z]");
  }
  return {numbers[0].number(-kMostLength, kMostLength),
          numbers[1].number(-kMostLength, kMostLength),
          numbers[2].number(-kMostLength, kMostLength)};
}

/// Camera's axes as columns, in the world, and its centre.
Eigen::Matrix<double, 3, 4> camera_of(const JsonValue& matrix) {
  const std::vector<JsonValue> rows = matrix.elements();
  if (rows.size() != 3 && rows.size() != 4) {
    matrix.refuse(fmt::format("{} rows", rows.size()), "write 4 rows of 4 numbers");
  }
  Eigen::Matrix<double, 3, 4> camera;
  for (int row = 0; row < 3; ++row) {
    const std::vector<JsonValue> numbers = rows[static_cast<std::size_t>(row)].elements();
    if (numbers.size() != 4) {
      rows[static_cast<std::size_t>(row)].refuse(fmt::format("{} numbers", numbers.size()),
                                                 "write 4 rows of 4 numbers");
    }
    for (int column = 0; column < 4; ++column) {
      camera(row, column) =
          numbers[static_cast<std::size_t>(column)].number(-kMostLength, kMostLength);
    }
  }
  const Eigen::Matrix3d axes = camera.leftCols<3>();
  if (!((axes.transpose() * axes - Eigen::Matrix3d::Identity()).norm() < kRotationSlack) ||
      axes.determinant() < 0.0) {
    matrix.refuse("the camera's axes are no rotation", "correct it");
  }
  return camera;
}

/// As written, or img_path where file_path leaves out the extension.
std::string name_of(const JsonValue& frame) {
  const std::string path = frame["file_path"].text();
  const std::size_t slash = path.find_last_of("/\\");
  const bool has_ending =
      path.find('.', slash == std::string::npos ? 0 : slash + 1) != std::string::npos;
  return !has_ending && frame.has("img_path") ? frame["img_path"].text() : path;
}

double power_of(const JsonValue& frame, bool& is_coloured) {
  if (!frame.has("pl_intensity")) {
    return 1.0;
  }
  const JsonValue intensity = frame["pl_intensity"];
  if (!intensity.is_array()) {
    return intensity.number(1e-6, 1e6);
  }
  const std::vector<JsonValue> colours = intensity.elements();
  if (colours.size() != 3) {
    intensity.refuse(fmt::format("{} numbers", colours.size()), "write one, or [r, g, b]");
  }
  double sum = 0.0;
  for (const JsonValue& colour : colours) {
    sum += colour.number(1e-6, 1e6);
    is_coloured = is_coloured || colour.number() != colours[0].number();
  }
  return sum / 3.0;
}

}  // namespace

LightList parse_transforms(const JsonValue& root, LightCoordinates coordinates) {
  const bool is_mm = root.has("unit") && root["unit"].text() == "mm";
  if (coordinates == LightCoordinates::automatic && !is_mm) {
    root["frames"].refuse(
        "lights' positions (pl_pos) in a unit that the file does not name",
        "say which: --places positions (they are mm) or --places directions (from the origin)");
  }
  LightList list;
  std::optional<Eigen::Matrix<double, 3, 4>> camera;
  bool is_coloured = false;
  for (const JsonValue& frame : root["frames"].elements()) {
    const Eigen::Matrix<double, 3, 4> own = camera_of(frame["transform_matrix"]);
    if (!camera) {
      camera = own;
    }
    const double size = std::max(1.0, camera->rightCols<1>().norm());
    if ((own - *camera).leftCols<3>().norm() > kRotationSlack ||
        (own - *camera).rightCols<1>().norm() > kRotationSlack * size) {
      frame["transform_matrix"].refuse("another camera than the first frame's",
                                       "a session has one: keep the frames of one camera");
    }
    SessionLight light;
    light.name = name_of(frame);
    light.is_position = coordinates != LightCoordinates::directions;
    light.coordinates = camera->leftCols<3>().transpose() * vector_of(frame["pl_pos"]);
    if (light.coordinates.norm() < 1e-12) {
      frame["pl_pos"].refuse("the light is at the origin, where the object is", "correct it");
    }
    if (!light.is_position) {
      light.coordinates.normalize();
    }
    light.relative_power = power_of(frame, is_coloured);
    list.lights.push_back(std::move(light));
  }
  if (list.lights.empty()) {
    root["frames"].refuse("no frames", "list a frame for each picture");
  }
  if (is_coloured) {
    list.notes.emplace_back("pl_intensity differs between colours: only its mean is used");
  }
  return list;
}

std::string format_transforms(const CameraModel& camera, const Eigen::Vector3d& origin_world,
                              const std::vector<SessionLight>& lights,
                              const std::vector<std::string>& names) {
  HAARLIGHT_EXPECTS(names.size() == lights.size(), "one name per light");
  using Json = nlohmann::ordered_json;
  Eigen::Matrix4d matrix = camera.world_from_cam.matrix();
  matrix.block<3, 1>(0, 3) -= origin_world;
  matrix.col(1) *= -1.0;  // y up, z backward
  matrix.col(2) *= -1.0;
  Json rows = Json::array();
  for (int row = 0; row < 4; ++row) {
    rows.push_back({matrix(row, 0), matrix(row, 1), matrix(row, 2), matrix(row, 3)});
  }
  Json out;
  out["unit"] = "mm";
  out["camera_model"] = "OPENCV";
  out["w"] = camera.width;
  out["h"] = camera.height;
  out["fl_x"] = camera.fx;
  out["fl_y"] = camera.fy;
  out["cx"] = camera.cx;
  out["cy"] = camera.cy;
  const std::array<const char*, 5> names_of_lens = {"k1", "k2", "p1", "p2", "k3"};
  for (int i = 0; i < 5; ++i) {
    out[names_of_lens[static_cast<std::size_t>(i)]] = camera.distortion(i);
  }
  out["camera_angle_x"] = 2.0 * std::atan(0.5 * camera.width / camera.fx);
  out["camera_intrinsics"] = {camera.cx, camera.cy, camera.fx, camera.fy};
  Json frames = Json::array();
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const Eigen::Vector3d position = lights[k].coordinates - origin_world;
    frames.push_back({{"file_path", names[k]},
                      {"img_path", names[k]},
                      {"light", lights[k].name},
                      {"pl_pos", {position.x(), position.y(), position.z()}},
                      {"pl_intensity", {1.0, 1.0, 1.0}},
                      {"transform_matrix", rows}});
  }
  out["frames"] = std::move(frames);
  return out.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace haarlight::session
