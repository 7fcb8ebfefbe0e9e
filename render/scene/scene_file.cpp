// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <numbers>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kMaxLength = 1e9;
constexpr double kMaxRadiance = 1e30;
constexpr Range kPosition{.min = -kMaxLength, .max = kMaxLength};
constexpr std::size_t kMaxTriangles = std::size_t{1} << 26U;  // about 5 GB with its BVH

Vector3d to_vector(const std::vector<double>& values) {
  return {values[0], values[1], values[2]};
}

Vector3d vector_or(ConfigTable& table, std::string_view key, const Vector3d& fallback) {
  return to_vector(
      table.numbers_or(key, {fallback.x(), fallback.y(), fallback.z()}, kPosition));
}

class SceneReader {
 public:
  explicit SceneReader(const std::filesystem::path& path)
      : folder_(path.parent_path()), root_(ConfigTable::parse_file(path)) {}

  SceneFile read() {
    root_.integer_or("schema", 1, {.min = 1, .max = 1});
    root_.text_or("name", "");
    for (ConfigTable& table : root_.tables("material")) {
      read_material(table);
    }
    for (ConfigTable& table : root_.tables("mesh")) {
      read_mesh(table);
    }
    for (ConfigTable& table : root_.tables("sphere")) {
      const Vector3d centre = to_vector(table.numbers("centre", 3, kPosition));
      const double radius = table.number("radius", {.min = 1e-6, .max = kMaxLength});
      const auto subdivisions =
          static_cast<int>(table.integer_or("subdivisions", 5, {.min = 0, .max = 8}));
      const int material = material_of(table);
      if (has_room(table, std::size_t{20} << static_cast<unsigned>(2 * subdivisions))) {
        add(make_sphere(centre, radius, subdivisions, material));
      }
    }
    for (ConfigTable& table : root_.tables("box")) {
      const Vector3d low = to_vector(table.numbers("low", 3, kPosition));
      const Vector3d high = to_vector(table.numbers("high", 3, kPosition));
      if (!((high - low).minCoeff() > 0.0)) {
        table.problem("high", "a box without volume", "every number of high must exceed low's");
      }
      add(make_box(low, high, material_of(table)));
    }
    for (ConfigTable& table : root_.tables("quad")) {
      const std::vector<double> c = table.matrix("corners", 4, 3, kPosition);
      add(make_quad({c[0], c[1], c[2]}, {c[3], c[4], c[5]}, {c[6], c[7], c[8]},
                    {c[9], c[10], c[11]}, material_of(table)));
    }
    if (std::optional<ConfigTable> table = root_.table("camera")) {
      read_camera(*table);
    }
    if (file_.scene.meshes.empty()) {
      root_.problem("", "the scene is empty",
                    "add a [[mesh]], [[sphere]], [[box]] or [[quad]]");
    }
    root_.finish();
    return std::move(file_);
  }

 private:
  /// Whether that many more triangles fit; else records a problem at `table`, once.
  bool has_room(ConfigTable& table, std::size_t n_triangles) {
    if (n_triangles <= kMaxTriangles - n_triangles_) {
      n_triangles_ += n_triangles;
      return true;
    }
    if (!is_full_) {
      table.problem("", "more than 2^26 triangles in the scene",
                    "use fewer subdivisions or simpler meshes");
    }
    is_full_ = true;
    return false;
  }
  void add(Mesh mesh) { file_.scene.meshes.push_back(std::move(mesh)); }

  void read_material(ConfigTable& table) {
    Material material;
    material.name = table.text("name");
    const std::vector<double> kd =
        table.has("kd") ? table.numbers("kd", 0) : std::vector<double>{0.5};
    if (kd.size() == 1) {
      material.kd.setConstant(kd[0]);
    } else if (kd.size() == 3) {
      material.kd = to_vector(kd);
    } else {
      table.problem("kd", "an albedo of other than 1 or 3 numbers",
                    "give grey or red, green, blue");
    }
    if (material.kd.minCoeff() < 0.0 || material.kd.maxCoeff() > 1.0) {
      table.problem("kd", "an albedo outside 0..1", "give the reflected fraction of the light");
    }
    material.ks = table.number_or("ks", 0.0, {.min = 0.0, .max = 1.0});
    material.exponent = table.number_or("exponent", 1.0, {.min = 0.0, .max = 1e5});
    if (table.has("emits")) {
      material.emits = to_vector(table.numbers("emits", 3, {.min = 0.0, .max = kMaxRadiance}));
    }
    for (const Material& other : file_.scene.materials) {
      if (other.name == material.name) {
        table.problem("name", fmt::format("a second material '{}'", material.name),
                      "give each material its own name");
      }
    }
    file_.scene.materials.push_back(std::move(material));
  }

  /// The index of the material named by the table's `material`.
  int material_of(ConfigTable& table) {
    const std::string name = table.text("material");
    std::vector<std::string> names;
    for (std::size_t i = 0; i < file_.scene.materials.size(); ++i) {
      if (file_.scene.materials[i].name == name) {
        return static_cast<int>(i);
      }
      names.push_back(file_.scene.materials[i].name);
    }
    const std::string nearest = nearest_word(name, names);
    table.problem("material", fmt::format("no [[material]] is named '{}'", name),
                  nearest.empty() ? "add it" : fmt::format("did you mean '{}'?", nearest));
    return 0;
  }

  void read_mesh(ConfigTable& table) {
    const std::string name = table.text("file");
    const int material = table.has("material") ? material_of(table) : -1;
    const Vector3d translate = vector_or(table, "translate", Vector3d::Zero());
    const double scale = table.number_or("scale", 1.0, {.min = 1e-9, .max = 1e9});
    const double turn_deg = table.number_or("rotate_z_deg", 0.0, {.min = -1e6, .max = 1e6});
    if (name.empty()) {
      return;
    }
    const std::filesystem::path path = folder_ / name;
    const std::string ending = path.extension().string();
    if (ending != ".obj" && ending != ".ply") {
      table.problem("file", fmt::format("'{}' is neither .obj nor .ply", name),
                    "save the mesh in one of these forms");
      return;
    }
    Scene added;
    try {
      added = ending == ".obj" ? read_obj(path) : read_ply(path);
    } catch (const Error& error) {
      table.problem("file", fmt::format("{} ({})", error.problem(), error.where()),
                    error.hint());
      return;
    }
    std::size_t n_triangles = 0;
    for (const Mesh& mesh : added.meshes) {
      n_triangles += mesh.triangles.size();
    }
    if (!has_room(table, n_triangles)) {
      return;
    }
    const Eigen::Matrix3d turn =
        Eigen::AngleAxisd(turn_deg * std::numbers::pi / 180.0, Vector3d::UnitZ())
            .toRotationMatrix();
    for (Mesh& mesh : added.meshes) {
      for (Vector3d& v : mesh.vertices) {
        v = turn * (scale * v) + translate;
      }
      for (Vector3d& n : mesh.normals) {
        n = turn * n;
      }
    }
    if (material >= 0) {
      for (Mesh& mesh : added.meshes) {
        mesh.material = material;
        file_.scene.meshes.push_back(std::move(mesh));
      }
    } else {
      append_scene(file_.scene, added);
    }
  }

  void read_camera(ConfigTable& table) {
    CameraModel camera;
    const std::vector<double> size = table.numbers("size", 2);
    for (const double pixels : size) {
      if (!(pixels >= 1.0 && pixels <= 65536.0) || pixels != std::floor(pixels)) {
        table.problem("size", "a picture's size is two whole numbers from 1 to 65536",
                      "size = [width, height]");
        return;
      }
    }
    camera.width = static_cast<int>(size[0]);
    camera.height = static_cast<int>(size[1]);
    if (table.has("eye")) {
      const Vector3d eye = to_vector(table.numbers("eye", 3, kPosition));
      const Vector3d target = to_vector(table.numbers("target", 3, kPosition));
      const Vector3d up = vector_or(table, "up", Vector3d::UnitZ());
      if ((target - eye).cross(up).norm() < 1e-9 * (target - eye).norm() * up.norm()) {
        table.problem("up", "the camera looks along its own up direction", "choose another up");
        return;
      }
      camera.world_from_cam = look_at(eye, target, up);
      if (table.has("width_mm")) {
        file_.optics.pixel_mm =
            table.number("width_mm", {.min = 1e-6, .max = kMaxLength}) / camera.width;
      } else {
        const double fov_deg = table.number("fov_y_deg", {.min = 1e-3, .max = 179.0});
        camera.fy = 0.5 * camera.height / std::tan(0.5 * fov_deg * std::numbers::pi / 180.0);
        camera.fx = camera.fy;
      }
      camera.cx = 0.5 * camera.width;
      camera.cy = 0.5 * camera.height;
    } else {
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
    if (table.has("dist")) {
      const std::vector<double> dist = table.numbers("dist", 5, {.min = -1e3, .max = 1e3});
      for (int i = 0; i < 5; ++i) {
        camera.distortion[i] = dist[static_cast<std::size_t>(i)];
      }
    }
    if (table.has("lens_radius_mm")) {
      if (file_.optics.pixel_mm > 0.0) {
        table.problem("lens_radius_mm", "an orthographic camera has no lens",
                      "leave it out, or give fov_y_deg instead of width_mm");
      }
      file_.optics.lens_radius_mm =
          table.number("lens_radius_mm", {.min = 0.0, .max = kMaxLength});
      file_.optics.focus_mm = table.number("focus_mm", {.min = 1e-6, .max = kMaxLength});
    }
    file_.camera = camera;
    file_.has_camera = true;
  }

  std::filesystem::path folder_;
  ConfigTable root_;
  SceneFile file_;
  std::size_t n_triangles_ = 0;  ///< of file_, spheres' rounded up; not boxes and quads
  bool is_full_ = false;
};

}  // namespace

SceneFile read_scene(const std::filesystem::path& path) { return SceneReader(path).read(); }

}  // namespace haarlight::render
