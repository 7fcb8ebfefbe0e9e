// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/volume_look.h"

#include <cmath>
#include <numbers>
#include <string_view>
#include <utility>

#include <Eigen/Core>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"
#include "http/json_text.h"

namespace haarlight::apps {

namespace {

constexpr double kMostValue = 1e100;  ///< as of a scene file
constexpr double kDegree = std::numbers::pi / 180.0;

std::array<double, 3> numbers_of(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

VolumeSceneWords::Field field_words(ConfigTable& table) {
  VolumeSceneWords::Field field{
      .name = table.text("field"), .on = table.text_or("on", ""), .component = std::nullopt};
  if (table.has("component")) {
    field.component = table.integer("component");
  }
  return field;
}

/// The same view by eye and target, of a camera by K and world_from_cam.
void look_of_matrices(const render::VolumeScene& scene, const std::string& where,
                      VolumeLook& look) {
  const CameraModel& camera = scene.camera;
  const double centred = 1e-9 * (camera.width + camera.height);
  if (std::abs(camera.cx - 0.5 * camera.width) > centred ||
      std::abs(camera.cy - 0.5 * camera.height) > centred ||
      std::abs(camera.fx - camera.fy) > centred) {
    throw Error(
        "the page turns cameras whose axis meets the picture's middle, with square pixels",
        where, "give [camera] an eye, a target and fov_y_deg instead of K");
  }
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const auto& point : scene.mesh.points) {
    middle += point / static_cast<double>(scene.mesh.points.size());
  }
  const Eigen::Matrix3d axes = camera.world_from_cam.linear();
  const Eigen::Vector3d eye = camera.centre_world();
  const double far = std::max(axes.col(2).dot(middle - eye), 1e-3 * (middle - eye).norm());
  look.eye = numbers_of(eye);
  look.target = numbers_of(eye + (far > 0.0 ? far : 1.0) * axes.col(2));
  look.up = numbers_of(-axes.col(1));
  look.opening = 2.0 * std::atan(0.5 * camera.height / camera.fy) / kDegree;
}

template <std::size_t N>
std::array<double, N> numbers_in(const JsonValue& json, double most) {
  const std::vector<JsonValue> elements = json.elements();
  if (elements.size() != N) {
    json.refuse(fmt::format("{} numbers where {} are wanted", elements.size(), N),
                "docs/reference/http-api.md tells what a view is");
  }
  std::array<double, N> numbers{};
  for (std::size_t i = 0; i < N; ++i) {
    numbers.at(i) = elements[i].number(-most, most);
  }
  return numbers;
}

template <std::size_t N>
std::vector<std::array<double, N>> rows_in(const JsonValue& json) {
  const std::vector<JsonValue> elements = json.elements();
  if (elements.empty() || elements.size() > kMostRows) {
    json.refuse(fmt::format("{} rows", elements.size()),
                fmt::format("give 1 to {} of them", kMostRows));
  }
  std::vector<std::array<double, N>> rows;
  for (const JsonValue& element : elements) {
    const std::array<double, N> row = numbers_in<N>(element, kMostValue);
    if (!rows.empty() && !(row[0] > rows.back()[0])) {
      element.refuse(fmt::format("the values of its rows must ascend, and {} follows {}",
                                 row[0], rows.back()[0]),
                     "sort the rows by their first number, each value once");
    }
    for (std::size_t i = 1; i < N; ++i) {
      if (row.at(i) < 0.0) {
        element.refuse(fmt::format("{} is negative", row.at(i)),
                       "what follows the first number of a row is 0 or more");
      }
    }
    rows.push_back(row);
  }
  return rows;
}

std::string rows_text(const auto& rows) {
  std::string text = "points = [\n";
  for (const auto& row : rows) {
    text += fmt::format("  [{}],\n", fmt::join(row, ", "));
  }
  return text + "]\n";
}

std::string field_text(const VolumeSceneWords::Field& field) {
  std::string text = fmt::format("field = {}\n", http::json_quote(field.name));
  if (!field.on.empty()) {
    text += fmt::format("on = {}\n", http::json_quote(field.on));
  }
  if (field.component) {
    text += fmt::format("component = {}\n", *field.component);
  }
  return text;
}

std::string file_text(const char* key, const std::filesystem::path& file) {
  return fmt::format(
      "{} = {}\n", key,
      http::json_quote(std::filesystem::absolute(file).lexically_normal().string()));
}

std::string camera_text(const VolumeLook& look, const std::array<int, 2>& size,
                        const render::CameraOptics& optics) {
  std::string text = fmt::format(
      "size = [{}, {}]\neye = [{}]\ntarget = [{}]\nup = [{}]\n{} = {}\n", size[0], size[1],
      fmt::join(look.eye, ", "), fmt::join(look.target, ", "), fmt::join(look.up, ", "),
      look.is_orthographic ? "width_mm" : "fov_y_deg", look.opening);
  if (optics.near_mm > 0.0) {
    text += fmt::format("near_mm = {}\n", optics.near_mm);
  }
  if (optics.far_mm > 0.0) {
    text += fmt::format("far_mm = {}\n", optics.far_mm);
  }
  return text;
}

std::string rgb_text(const char* key, const Eigen::Array3d& rgb) {
  return fmt::format("{} = [{}, {}, {}]\n", key, rgb[0], rgb[1], rgb[2]);
}

std::string contours_text(const VolumeSceneWords& words, const render::VolumeScene& scene) {
  std::string text;
  for (const render::Contour& contour : scene.contours) {
    text +=
        fmt::format("\n[[contour]]\n{}value = {}\n{}opacity = {}\n", field_text(words.contour),
                    contour.value, rgb_text("colour", contour.colour), contour.opacity);
    text += fmt::format("ambient = {}\ndiffuse = {}\nspecular = {}\nexponent = {}\n",
                        contour.ambient, contour.diffuse, contour.specular, contour.exponent);
  }
  return text;
}

std::string backdrop_text(const render::VolumeScene& scene) {
  if (scene.surfaces) {
    return "\n[behind]\n" + file_text("picture", scene.surfaces->file);
  }
  const render::Background& background = scene.background;
  std::string text = "\n[background]\n";
  switch (background.kind) {
    case render::BackgroundKind::colour:
      return text + rgb_text("colour", background.colour);
    case render::BackgroundKind::gradient:
      return text + rgb_text("top", background.colour) + rgb_text("bottom", background.other);
    case render::BackgroundKind::checker:
      return text + fmt::format("checker = [[{}], [{}]]\nsquare = {}\n",
                                fmt::join(background.colour, ", "),
                                fmt::join(background.other, ", "), background.square_px);
    case render::BackgroundKind::picture:
      return text + file_text("picture", background.file);
  }
  return text;
}

}  // namespace

VolumeSceneWords read_scene_words(const std::filesystem::path& path,
                                  const render::VolumeScene& scene) {
  ConfigTable root = ConfigTable::parse_file(path);
  VolumeSceneWords words;
  words.name = root.text_or("name", "");
  if (std::optional<ConfigTable> mesh = root.table("mesh")) {
    words.format = mesh->text_or("format", "");
  }
  if (std::optional<ConfigTable> density = root.table("density")) {
    words.density = field_words(*density);
  }
  std::optional<ConfigTable> colour = root.table("colour");
  words.colour = colour ? field_words(*colour) : words.density;
  for (ConfigTable& contour : root.tables("contour")) {
    words.contour = field_words(contour);
  }
  VolumeLook& look = words.look;
  look.size = {scene.camera.width, scene.camera.height};
  std::optional<ConfigTable> camera = root.table("camera");
  if (camera && camera->has("eye")) {
    const auto vector = [](const std::vector<double>& v) {
      return std::array{v.at(0), v.at(1), v.at(2)};
    };
    look.eye = vector(camera->numbers("eye", 3));
    look.target = vector(camera->numbers("target", 3));
    look.up = vector(camera->numbers_or("up", {0.0, 0.0, 1.0}));
    look.is_orthographic = camera->has("width_mm");
    look.opening = camera->number(look.is_orthographic ? "width_mm" : "fov_y_deg");
  } else {
    look_of_matrices(scene, path.string(), look);
  }
  for (std::size_t i = 0; i < scene.density.values().size(); ++i) {
    look.density.push_back({scene.density.breakpoints()[i], scene.density.values()[i]});
  }
  for (std::size_t i = 0; i < scene.colour.values().size(); ++i) {
    const Eigen::Array3d& rgb = scene.colour.values()[i];
    look.colour.push_back({scene.colour.breakpoints()[i], rgb[0], rgb[1], rgb[2]});
  }
  return words;
}

VolumeLook read_look(const JsonValue& json) {
  VolumeLook look;
  const std::vector<JsonValue> size = json["size"].elements();
  if (size.size() != 2) {
    json["size"].refuse("a size is two whole numbers", "give [width, height]");
  }
  for (std::size_t i = 0; i < 2; ++i) {
    look.size.at(i) = static_cast<int>(
        size[i].integer(1, static_cast<std::int64_t>(render::kMaxPictureSide)));
  }
  const JsonValue camera = json["camera"];
  look.eye = numbers_in<3>(camera["eye"], render::kMaxLength);
  look.target = numbers_in<3>(camera["target"], render::kMaxLength);
  look.up = numbers_in<3>(camera["up"], render::kMaxLength);
  look.is_orthographic = camera.has("width_mm");
  look.opening = look.is_orthographic ? camera["width_mm"].number(1e-6, render::kMaxLength)
                                      : camera["fov_y_deg"].number(1e-3, 179.0);
  look.density = rows_in<2>(json["density"]);
  look.colour = rows_in<4>(json["colour"]);
  return look;
}

render::CameraTable camera_of(const VolumeLook& look, const std::array<int, 2>& size,
                              const render::CameraOptics& optics) {
  ConfigTable table =
      ConfigTable::parse_text(camera_text(look, size, optics), "the view's camera");
  std::optional<render::CameraTable> read = render::read_camera_table(table);
  table.finish();
  return std::move(*read);
}

void set_functions(const VolumeLook& look, render::VolumeScene& scene) {
  std::vector<double> breakpoints;
  std::vector<double> extinctions;
  for (const std::array<double, 2>& row : look.density) {
    breakpoints.push_back(row[0]);
    extinctions.push_back(row[1]);
  }
  scene.density = {std::move(breakpoints), std::move(extinctions)};
  std::vector<double> of_colours;
  std::vector<Eigen::Array3d> colours;
  for (const std::array<double, 4>& row : look.colour) {
    of_colours.push_back(row[0]);
    colours.emplace_back(row[1], row[2], row[3]);
  }
  scene.colour = {std::move(of_colours), std::move(colours)};
}

std::string scene_text(const VolumeSceneWords& words, const render::VolumeScene& scene,
                       const VolumeLook& look) {
  std::string text =
      fmt::format("schema = 1\nname = {}\n\n[mesh]\n{}", http::json_quote(words.name),
                  file_text("file", scene.mesh_file));
  if (!scene.solution_file.empty()) {
    text += file_text("solution", scene.solution_file);
  }
  if (!words.format.empty()) {
    text += fmt::format("format = {}\n", http::json_quote(words.format));
  }
  text += fmt::format("\n[density]\n{}{}", field_text(words.density), rows_text(look.density));
  text += fmt::format("\n[colour]\n{}glow = \"{}\"\n{}", field_text(words.colour),
                      to_string(scene.glow), rows_text(look.colour));
  return text + contours_text(words, scene) + backdrop_text(scene) + "\n[camera]\n" +
         camera_text(look, look.size, scene.optics);
}

}  // namespace haarlight::apps
