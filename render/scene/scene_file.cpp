// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <span>
#include <string_view>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"
#include "haarlight/render/scene/scene.h"
#include "haarlight/render/scene/scene_io.h"
#include "render/scene/camera_table.h"
#include "render/scene/metals.h"

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr double kFlat = 1e-4;  // of a quad's size: corners may be given to four digits
constexpr double kMaxRadiance = 1e30;
constexpr double kMaxScale = 1e10;  // of an environment, whose texels are at most 1e20
constexpr Range kPosition{.min = -kMaxLength, .max = kMaxLength};
constexpr Range kCoatIor{.min = 1.2, .max = 2.5};  // of the table of coats, render/bsdf/

/// The keys of a material that are not every bsdf's, and those of each.
constexpr auto kScatteringKeys = std::to_array<std::string_view>(
    {"kd", "kd_texture", "texture_scale", "ks", "exponent", "sigma_deg", "reflectance", "ior",
     "roughness", "metal", "eta", "k"});
constexpr auto kBlinnPhongKeys =
    std::to_array<std::string_view>({"kd", "kd_texture", "texture_scale", "ks", "exponent"});
constexpr auto kOrenNayarKeys =
    std::to_array<std::string_view>({"kd", "kd_texture", "texture_scale", "sigma_deg"});
constexpr auto kMirrorKeys = std::to_array<std::string_view>({"reflectance"});
constexpr auto kDielectricKeys = std::to_array<std::string_view>({"ior"});
constexpr auto kConductorKeys =
    std::to_array<std::string_view>({"roughness", "metal", "eta", "k"});
constexpr auto kCoatedKeys =
    std::to_array<std::string_view>({"kd", "kd_texture", "texture_scale", "ior", "roughness"});

std::span<const std::string_view> keys_of(BsdfKind kind) {
  switch (kind) {
    case BsdfKind::blinn_phong:
      break;
    case BsdfKind::oren_nayar:
      return kOrenNayarKeys;
    case BsdfKind::mirror:
      return kMirrorKeys;
    case BsdfKind::dielectric:
      return kDielectricKeys;
    case BsdfKind::conductor:
      return kConductorKeys;
    case BsdfKind::coated:
      return kCoatedKeys;
  }
  return kBlinnPhongKeys;
}

enum class LightKind : std::uint8_t { point, spot, directional };
constexpr auto kLightWords = std::to_array<std::string_view>({"point", "spot", "directional"});
constexpr std::span<const std::string_view> words_of(LightKind) { return kLightWords; }

double radians(double degrees) { return degrees * std::numbers::pi / 180.0; }

Vector3d to_vector(const std::vector<double>& values) {
  return {values[0], values[1], values[2]};
}

Vector3d vector_or(ConfigTable& table, std::string_view key, const Vector3d& fallback) {
  return to_vector(
      table.numbers_or(key, {fallback.x(), fallback.y(), fallback.z()}, kPosition));
}

std::size_t to_index(int i) { return static_cast<std::size_t>(i); }

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
      read_named_mesh(table);
    }
    for (ConfigTable& table : root_.tables("instance")) {
      read_instance(table);
    }
    for (ConfigTable& table : root_.tables("sphere")) {
      read_sphere(table);
    }
    for (ConfigTable& table : root_.tables("box")) {
      read_box(table);
    }
    for (ConfigTable& table : root_.tables("quad")) {
      read_quad(table);
    }
    for (ConfigTable& table : root_.tables("disk")) {
      file_.scene.disks.push_back(
          {.centre = to_vector(table.numbers("centre", 3, kPosition)),
           .normal = direction_of(table, "normal"),
           .radius_mm = table.number("radius", {.min = 1e-6, .max = kMaxLength}),
           .material = plain_material_of(table, "disk")});
    }
    for (ConfigTable& table : root_.tables("light")) {
      read_light(table);
    }
    if (std::optional<ConfigTable> table = root_.table("environment")) {
      file_.scene.environment = {
          .file = folder_ / table->text("file"),
          .rotate_z_rad = radians(table->number_or("rotate_z_deg", 0.0, {-1e6, 1e6})),
          .scale = table->number_or("scale", 1.0, {.min = 0.0, .max = kMaxScale})};
    }
    if (std::optional<ConfigTable> table = root_.table("camera")) {
      read_camera(*table);
    }
    if (std::optional<ConfigTable> table = root_.table("film")) {
      read_film(*table);
    }
    if (file_.scene.meshes.empty() && file_.scene.spheres.empty() &&
        file_.scene.disks.empty()) {
      root_.problem("", "the scene is empty",
                    "add a [[mesh]], [[sphere]], [[box]], [[quad]] or [[disk]]");
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

  [[nodiscard]] bool has_texture(int material) const {
    return to_index(material) < file_.scene.materials.size() &&
           !file_.scene.materials[to_index(material)].kd_texture.file.empty();
  }

  void read_sphere(ConfigTable& table) {
    const Vector3d centre = to_vector(table.numbers("centre", 3, kPosition));
    const double radius = table.number("radius", {.min = 1e-6, .max = kMaxLength});
    if (table.flag_or("exact", false)) {
      file_.scene.spheres.push_back(
          {.centre = centre, .radius_mm = radius, .material = material_of(table)});
      return;
    }
    const auto subdivisions =
        static_cast<int>(table.integer_or("subdivisions", 5, {.min = 0, .max = 8}));
    const int material = material_of(table);
    if (has_room(table, std::size_t{20} << static_cast<unsigned>(2 * subdivisions)) &&
        !root_.has_problems()) {  // a refused file's spheres are not made
      add(has_texture(material) ? make_textured_sphere(centre, radius, subdivisions, material)
                                : make_sphere(centre, radius, subdivisions, material));
    }
  }

  void read_box(ConfigTable& table) {
    const Vector3d low = to_vector(table.numbers("low", 3, kPosition));
    const Vector3d high = to_vector(table.numbers("high", 3, kPosition));
    if (!((high - low).minCoeff() > 0.0)) {
      table.problem("high", "a box without volume", "every number of high must exceed low's");
    }
    const int material = material_of(table);
    add(has_texture(material) ? make_textured_box(low, high, material)
                              : make_box(low, high, material));
  }

  void read_quad(ConfigTable& table) {
    const std::vector<double> c = table.matrix("corners", 4, 3, kPosition);
    const std::array<Vector3d, 4> corners{
        {{c[0], c[1], c[2]}, {c[3], c[4], c[5]}, {c[6], c[7], c[8]}, {c[9], c[10], c[11]}}};
    if (!root_.has_problems()) {  // of a refused file's corners some may be missing
      require_quad(table, corners);
    }
    add(make_quad(corners[0], corners[1], corners[2], corners[3], material_of(table)));
  }

  /// Records a problem where the two triangles of a quad, cut from its first corner to its third,
  /// are not a flat surface whose parts lie side by side.
  static void require_quad(ConfigTable& table, const std::array<Vector3d, 4>& corners) {
    const auto& [a, b, c, d] = corners;
    const double size = std::max((c - a).norm(), (d - b).norm());
    double reach = 0.0;  // of the coordinates, whose differences are rounded
    for (const Vector3d& corner : corners) {
      reach = std::max(reach, corner.cwiseAbs().maxCoeff());
    }
    const auto area = [](const Vector3d& p, const Vector3d& q, const Vector3d& r) -> Vector3d {
      return (q - p).cross(r - p);  // twice the triangle's
    };
    const Vector3d first = area(a, b, c);
    const Vector3d second = area(a, c, d);
    const bool is_first_larger = first.norm() >= second.norm();
    const Vector3d& larger = is_first_larger ? first : second;
    constexpr double kRounding = 16.0 * std::numeric_limits<double>::epsilon();
    if (!(larger.norm() > kRounding * size * (size + reach))) {
      table.problem("corners", "the quad has no area: its corners lie on one line",
                    "give the four corners in their order around it");
      return;
    }
    const Vector3d normal = larger.normalized();
    const double off = std::abs(normal.dot(is_first_larger ? d - a : b - a));
    if (off > kFlat * size) {
      table.problem(
          "corners",
          fmt::format("the quad is not flat: one corner is {:.3g} mm off the plane of "
                      "the others",
                      off),
          "correct the corner, or give a mesh of two triangles");
      return;
    }
    // Beyond the cut by more than numbers of four digits explain.
    const double beyond = -normal.dot(is_first_larger ? second : first);
    if (!(beyond > kFlat * size * (c - a).norm())) {
      return;
    }
    const bool is_concave = area(a, b, d).dot(area(b, c, d)) > 0.0;
    table.problem("corners",
                  is_concave ? "the quad is concave at its second or fourth corner"
                             : "the quad's sides cross: a bow-tie",
                  is_concave ? "begin with the next corner: it is cut from the first to the "
                               "third"
                             : "give the four corners in their order around it: exchange the "
                               "last two, or the second and the third");
  }

  void read_material(ConfigTable& table) {
    Material material;
    material.name = table.text("name");
    material.bsdf = table.one_of_or("bsdf", BsdfKind::blinn_phong);
    refuse_other_keys(table, material.bsdf);
    read_scattering(table, material);
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

  /// Records a problem for each key that belongs to other BSDFs only.
  static void refuse_other_keys(ConfigTable& table, BsdfKind kind) {
    const std::span<const std::string_view> own = keys_of(kind);
    std::string list;
    for (const std::string_view key : own) {
      list += fmt::format("{}{}", list.empty() ? "" : ", ", key);
    }
    for (const std::string_view key : kScatteringKeys) {
      if (!table.has(key) || std::ranges::find(own, key) != own.end()) {
        continue;
      }
      table.problem(key, fmt::format("{} is no key of bsdf = \"{}\"", key, to_string(kind)),
                    fmt::format("remove it, or choose another bsdf; this one has {}", list));
      // Read, so that it is not reported as unknown, too.
      if (table.is_text(key)) {
        table.text(key);
      } else if (key == "kd" || key == "reflectance" || key == "eta" || key == "k" ||
                 key == "texture_scale") {
        table.numbers(key, 0);
      } else {
        table.number(key);
      }
    }
  }

  /// One number for grey, or red, green, blue.
  static Vector3d colour_or(ConfigTable& table, std::string_view key, double fallback) {
    if (!table.has(key)) {
      return Vector3d::Constant(fallback);
    }
    const std::vector<double> values = table.numbers(key, 0);
    if (values.size() != 1 && values.size() != 3) {
      table.problem(key, fmt::format("{} has other than 1 or 3 numbers", key),
                    "give grey or red, green, blue");
      return Vector3d::Constant(fallback);
    }
    return values.size() == 1 ? Vector3d::Constant(values[0]) : to_vector(values);
  }

  /// The same, of fractions.
  static Vector3d albedo_or(ConfigTable& table, std::string_view key, double fallback) {
    Vector3d albedo = colour_or(table, key, fallback);
    if (albedo.minCoeff() < 0.0 || albedo.maxCoeff() > 1.0) {
      table.problem(key, "an albedo outside 0..1", "give the reflected fraction of the light");
      return Vector3d::Constant(fallback);
    }
    return albedo;
  }

  /// kd_texture and texture_scale. @return kd's default beside it
  double read_kd_texture(ConfigTable& table, Material& material) const {
    const bool has_scale = table.has("texture_scale");
    const std::vector<double> scale = table.numbers_or(
        "texture_scale", {1.0, 1.0}, {.min = -kMaxTextureScale, .max = kMaxTextureScale});
    if (!table.has("kd_texture")) {
      if (has_scale) {
        table.problem("texture_scale", "a scale without a texture",
                      R"(add kd_texture = "FILE.png", or remove it)");
      }
      return 0.5;
    }
    const std::string name = table.text("kd_texture");
    if (name.empty()) {
      table.problem("kd_texture", "kd_texture names no file", "name a picture, or remove it");
      return 1.0;
    }
    material.kd_texture = {.file = (folder_ / name).lexically_normal().string(),
                           .where = table.where("kd_texture"),
                           .scale = {scale[0], scale[1]}};
    return 1.0;
  }

  void read_scattering(ConfigTable& table, Material& material) const {
    const bool has_kd = std::ranges::count(keys_of(material.bsdf), "kd") > 0;
    const double kd = has_kd ? read_kd_texture(table, material) : 0.0;
    switch (material.bsdf) {
      case BsdfKind::blinn_phong:
        material.kd = albedo_or(table, "kd", kd);
        material.ks = table.number_or("ks", 0.0, {.min = 0.0, .max = 1.0});
        material.exponent = table.number_or("exponent", 1.0, {.min = 0.0, .max = 1e5});
        if (material.kd.maxCoeff() + material.ks > 1.0 + 1e-9) {
          table.problem("ks",
                        fmt::format("kd + ks = {:.6g}: more light is reflected than arrives",
                                    material.kd.maxCoeff() + material.ks),
                        "give kd and ks a sum of at most 1");
        }
        break;
      case BsdfKind::oren_nayar:
        material.kd = albedo_or(table, "kd", kd);
        material.sigma = radians(table.number("sigma_deg", {.min = 0.0, .max = 90.0}));
        break;
      case BsdfKind::mirror:
        material.reflectance = albedo_or(table, "reflectance", 1.0);
        break;
      case BsdfKind::dielectric:
        material.ior = table.number_or("ior", 1.5, {.min = 1.0, .max = 4.0});
        break;
      case BsdfKind::conductor:
        read_roughness(table, material);
        read_metal(table, material);
        break;
      case BsdfKind::coated:
        material.kd = albedo_or(table, "kd", kd);
        material.ior = table.number_or("ior", 1.5, kCoatIor);
        read_roughness(table, material);
        break;
    }
  }

  static void read_roughness(ConfigTable& table, Material& material) {
    material.roughness = table.number_or("roughness", 0.1, {.min = 1e-4, .max = 1.0});
  }

  /// metal, or eta and k.
  static void read_metal(ConfigTable& table, Material& material) {
    ComplexIor ior = ior_of(Metal::aluminium);
    if (table.has("metal")) {
      if (table.has("eta") || table.has("k")) {
        table.problem("metal", "a metal by its name and by its numbers",
                      "give metal, or eta and k");
      }
      ior = ior_of(table.one_of<Metal>("metal"));
    } else if (!table.has("eta") || !table.has("k")) {
      table.problem("", "a conductor without a metal",
                    R"(add metal = "aluminium", "copper", "gold" or "silver", or eta and k)");
    }
    const auto part = [&](std::string_view key, const Vector3d& fallback, double least) {
      Vector3d values = table.has(key) ? colour_or(table, key, 1.0) : fallback;
      if (values.minCoeff() < least || values.maxCoeff() > 20.0) {
        table.problem(key, fmt::format("{} is out of range", key),
                      fmt::format("write numbers from {} to 20", least));
        return fallback;
      }
      return values;
    };
    material.eta = part("eta", ior.eta, 0.01);
    material.k = part("k", ior.k, 0.0);
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

  /// The same for a shape without texture coordinates.
  int plain_material_of(ConfigTable& table, std::string_view shape) {
    const int material = material_of(table);
    if (to_index(material) < file_.scene.materials.size()) {
      refuse_texture(table, "material", file_.scene.materials[to_index(material)],
                     fmt::format("a {}", shape));
    }
    return material;
  }

  /// Records a problem at `key` where what is covered by the material has no texture coordinates.
  static void refuse_texture(ConfigTable& table, std::string_view key, const Material& material,
                             std::string_view what) {
    if (!material.kd_texture.file.empty()) {
      table.problem(
          key,
          fmt::format("{} has no texture coordinates; material '{}' has a texture", what,
                      material.name),
          "use another shape, a mesh that is exported with its UVs, or a material without "
          "a texture");
    }
  }

  /// A unit vector; any length but 0 in the file.
  static Vector3d direction_of(ConfigTable& table, std::string_view key) {
    const Vector3d direction = to_vector(table.numbers(key, 3, kPosition));
    if (!(direction.norm() > 0.0)) {
      table.problem(key, "a direction without length", "give it as [x, y, z], not all 0");
      return Vector3d::UnitZ();
    }
    return direction.normalized();
  }

  /// RGB of light, without an upper limit that a light could reach.
  static Vector3d light_of(ConfigTable& table, std::string_view key) {
    if (!table.has(key)) {
      table.problem(key, fmt::format("{} is missing", key), "give grey or red, green, blue");
      return Vector3d::Zero();
    }
    Vector3d light = colour_or(table, key, 0.0);
    if (light.minCoeff() < 0.0 || light.maxCoeff() > kMaxRadiance) {
      table.problem(key, fmt::format("{} is out of range", key),
                    "write numbers from 0 to 1e30");
      return Vector3d::Zero();
    }
    return light;
  }

  void read_light(ConfigTable& table) {
    switch (table.one_of<LightKind>("kind")) {
      case LightKind::point:
        file_.scene.point_lights.push_back(
            {.position = to_vector(table.numbers("position", 3, kPosition)),
             .intensity = light_of(table, "intensity")});
        break;
      case LightKind::spot:
        read_spot(table);
        break;
      case LightKind::directional:
        file_.scene.directional_lights.push_back({.direction = direction_of(table, "direction"),
                                                  .irradiance = light_of(table, "irradiance")});
        break;
    }
  }

  void read_spot(ConfigTable& table) {
    const Vector3d position = to_vector(table.numbers("position", 3, kPosition));
    const Vector3d way = to_vector(table.numbers("target", 3, kPosition)) - position;
    if (!(way.norm() > 0.0)) {
      table.problem("target", "the spot shines at itself", "give another point as target");
      return;
    }
    constexpr Range kConeAngle{.min = 0.0, .max = 180.0};
    const double end_deg = table.number("angle_deg", kConeAngle);
    const double full_deg = table.number_or("full_deg", end_deg, kConeAngle);
    if (full_deg > end_deg) {
      table.problem("full_deg", "the cone's full part is wider than the cone",
                    "give an angle of at most angle_deg");
    }
    file_.scene.point_lights.push_back({.position = position,
                                        .intensity = light_of(table, "intensity"),
                                        .axis = way.normalized(),
                                        .cos_full = std::cos(radians(full_deg)),
                                        .cos_end = std::cos(radians(end_deg))});
  }

  /// How a [[mesh]] or an [[instance]] is placed: turn * (scale * v) + translate.
  struct Placement {
    Vector3d translate;
    double scale;
    Eigen::Matrix3d turn;
  };
  static Placement read_placement(ConfigTable& table) {
    const Vector3d translate = vector_or(table, "translate", Vector3d::Zero());
    const double scale = table.number_or("scale", 1.0, {.min = 1e-9, .max = 1e9});
    const double turn_deg = table.number_or("rotate_z_deg", 0.0, {.min = -1e6, .max = 1e6});
    return {.translate = translate,
            .scale = scale,
            .turn = Eigen::AngleAxisd(turn_deg * std::numbers::pi / 180.0, Vector3d::UnitZ())
                        .toRotationMatrix()};
  }

  /// The meshes of one [[mesh]] that has a name: an OBJ file may have several.
  struct NamedMesh {
    std::string name;
    std::size_t first;
    std::size_t end;  ///< first, where its file could not be read
  };

  void read_named_mesh(ConfigTable& table) {
    const bool has_name = table.has("name");
    const std::string name = table.text_or("name", "");
    if (has_name && name.empty()) {
      table.problem("name", "a mesh with an empty name", "give it a name, or remove the key");
    }
    for (const NamedMesh& other : named_meshes_) {
      if (has_name && other.name == name) {
        table.problem("name", fmt::format("a second mesh '{}'", name),
                      "give each mesh its own name");
      }
    }
    const std::size_t first = file_.scene.meshes.size();
    read_mesh(table);
    if (has_name) {
      named_meshes_.push_back({.name = name, .first = first, .end = file_.scene.meshes.size()});
    }
  }

  void read_instance(ConfigTable& table) {
    const std::string name = table.text("mesh");
    const int material = table.has("material") ? material_of(table) : -1;
    const Placement placement = read_placement(table);
    const auto named = std::ranges::find(named_meshes_, name, &NamedMesh::name);
    if (named == named_meshes_.end()) {
      std::vector<std::string> names;
      for (const NamedMesh& mesh : named_meshes_) {
        names.push_back(mesh.name);
      }
      const std::string nearest = nearest_word(name, names);
      table.problem("mesh", fmt::format("no [[mesh]] is named '{}'", name),
                    nearest.empty() ? fmt::format("add name = \"{}\" to a [[mesh]]", name)
                                    : fmt::format("did you mean '{}'?", nearest));
      return;
    }
    Instance instance{.material = material};
    instance.world_from_mesh.linear() = placement.scale * placement.turn;
    instance.world_from_mesh.translation() = placement.translate;
    for (std::size_t m = named->first; m < named->end; ++m) {
      const Mesh& mesh = file_.scene.meshes[m];
      if (material >= 0 && mesh.uvs.empty() &&
          to_index(material) < file_.scene.materials.size()) {
        refuse_texture(table, "material", file_.scene.materials[to_index(material)],
                       fmt::format("mesh '{}'", name));
      }
      if (file_.scene.instances.size() == kMaxInstances) {
        if (!has_many_instances_) {
          table.problem("", "more than 2^20 instances in the scene",
                        "join some of them to one mesh, and instance that");
        }
        has_many_instances_ = true;
        return;
      }
      instance.mesh = static_cast<int>(m);
      file_.scene.instances.push_back(instance);
    }
  }

  /// @param has_materials  that of the file are wanted
  Scene read_mesh_file(const std::filesystem::path& path, bool has_materials) {
    if (!is_gltf(path)) {
      return path.extension() == ".obj" ? read_obj(path) : read_ply(path);
    }
    SceneFile file = read_gltf(path, {.has_materials = has_materials});
    file_.files.insert(file_.files.end(), file.files.begin(), file.files.end());
    return with_instances_expanded(std::move(file.scene), path.string());
  }

  void read_mesh(ConfigTable& table) {
    const std::string name = table.text("file");
    const int material = table.has("material") ? material_of(table) : -1;
    const Placement placement = read_placement(table);
    if (name.empty()) {
      return;
    }
    const std::filesystem::path path = folder_ / name;
    const std::string ending = path.extension().string();
    if (ending != ".obj" && ending != ".ply" && !is_gltf(path)) {
      table.problem("file", fmt::format("'{}' is neither .obj, .ply, .gltf nor .glb", name),
                    "save the mesh in one of these forms");
      return;
    }
    Scene added;
    try {
      added = read_mesh_file(path, material < 0);
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
    for (Mesh& mesh : added.meshes) {
      for (Vector3d& v : mesh.vertices) {
        v = placement.turn * (placement.scale * v) + placement.translate;
      }
      for (Vector3d& n : mesh.normals) {
        n = placement.turn * n;
      }
    }
    for (const Mesh& mesh : added.meshes) {
      const std::vector<Material>& materials =
          material >= 0 ? file_.scene.materials : added.materials;
      const std::size_t i = to_index(material >= 0 ? material : mesh.material);
      if (mesh.uvs.empty() && i < materials.size()) {
        refuse_texture(table, material >= 0 ? "material" : "file", materials[i],
                       fmt::format("'{}' of {}", mesh.name, name));
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

  /// After the camera, whose size is the picture's where [film] has none.
  void read_film(ConfigTable& table) {
    FilmSettings& film = file_.film;
    std::optional<std::array<int, 2>> size;
    if (table.has("size")) {
      film.size = size = picture_size_of(table);
    } else if (file_.has_camera) {
      size = {file_.camera.width, file_.camera.height};
    }
    if (table.has("crop")) {
      read_crop(table, size);
    }
    if (table.has("filter")) {
      film.filter = table.one_of<FilterKind>("filter");
    }
  }

  void read_crop(ConfigTable& table, const std::optional<std::array<int, 2>>& size) {
    const std::string text = table.text("crop");
    if (!table.is_text("crop")) {
      return;
    }
    file_.film.crop = parse_crop(text);
    file_.film.crop_where = table.where("crop");
    if (!file_.film.crop) {
      table.problem(
          "crop", fmt::format("crop = \"{}\" is no part of a picture", text),
          R"(write crop = "WxH+X+Y": width and height, and the first column and row, )"
          "from 0");
    } else if (size && !is_within(*file_.film.crop, (*size)[0], (*size)[1])) {
      table.problem("crop",
                    fmt::format("the crop {} is outside of the picture of {} x {} pixels", text,
                                (*size)[0], (*size)[1]),
                    "give X + W and Y + H at most the picture's width and height");
    }
  }

  void read_camera(ConfigTable& table) {
    if (const std::optional<CameraTable> read = read_camera_table(table)) {
      file_.camera = read->camera;
      file_.optics = read->optics;
      file_.has_camera = true;
    }
  }

  std::filesystem::path folder_;
  ConfigTable root_;
  SceneFile file_;
  std::size_t n_triangles_ = 0;  ///< of file_, spheres' rounded up; not boxes and quads
  bool is_full_ = false;
  std::vector<NamedMesh> named_meshes_;
  bool has_many_instances_ = false;
};

}  // namespace

SceneFile read_scene(const std::filesystem::path& path) {
  return is_gltf(path) ? read_gltf(path) : SceneReader(path).read();
}

}  // namespace haarlight::render
