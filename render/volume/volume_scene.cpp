// SPDX-License-Identifier: Apache-2.0
#include "render/volume/volume_scene.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "core/config_table.h"
#include "core/counted.h"
#include "haarlight/core/error.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/film/no_depth.h"
#include "render/scene/camera_table.h"

namespace haarlight::render {

namespace {

constexpr double kMaxValue = 1e100;  ///< of a field, a breakpoint, an extinction, a colour
constexpr Range kAnyValue{.min = -kMaxValue, .max = kMaxValue};
constexpr Range kPositive{.min = 0.0, .max = kMaxValue};

enum class FieldPlace : std::uint8_t { points, cells };
constexpr auto kFieldPlaceWords = std::to_array<std::string_view>({"points", "cells"});
constexpr std::span<const std::string_view> words_of(FieldPlace) { return kFieldPlaceWords; }

std::string names_of(const std::vector<MeshField>& fields) {
  std::vector<std::string> names;
  names.reserve(fields.size());
  for (const MeshField& field : fields) {
    names.push_back('\'' + field.name + '\'');
  }
  return names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "));
}

class VolumeSceneReader {
 public:
  explicit VolumeSceneReader(const std::filesystem::path& path)
      : folder_(path.parent_path()), root_(ConfigTable::parse_file(path)) {}

  VolumeScene read() {
    root_.integer_or("schema", 1, {.min = 1, .max = 1});
    root_.text_or("name", "");
    std::optional<ConfigTable> mesh = table_of("mesh", "name the file of the cells");
    std::optional<ConfigTable> density =
        table_of("density", "say which field the extinction is a function of");
    std::optional<ConfigTable> colour = root_.table("colour");
    MeshFileOptions options;
    if (mesh) {
      const std::string file = mesh->text("file");
      if (file.empty() && mesh->is_text("file")) {
        mesh->problem("file", "no name of a file", "name the file of the cells");
      }
      scene_.mesh_file = folder_ / file;
      if (mesh->has("format")) {
        options.format = mesh->one_of<MeshFormat>("format");
      }
      if (mesh->has("solution")) {
        scene_.solution_file = options.solution = folder_ / mesh->text("solution");
      }
    }
    if (density) {
      read_density(*density);
    }
    if (colour) {
      read_colour(*colour);
    }
    std::optional<FieldChoice> of_contours;
    for (ConfigTable& table : root_.tables("contour")) {
      read_contour(table, of_contours);
    }
    read_backdrop();
    if (std::optional<ConfigTable> camera = table_of("camera", "say where it is seen from")) {
      read_camera(*camera);
    }
    const std::optional<FieldChoice> of_density =
        density ? std::optional(choice_of(*density)) : std::nullopt;
    const std::optional<FieldChoice> of_colour =
        colour ? std::optional(choice_of(*colour)) : std::nullopt;
    root_.finish();
    scene_.mesh = read_cell_mesh(scene_.mesh_file, options);
    scene_.check = check_cell_mesh(scene_.mesh, scene_.mesh_file.string());
    scene_.density_field = field_of(*of_density);
    scene_.colour_field = of_colour ? field_of(*of_colour) : scene_.density_field;
    if (of_contours) {
      scene_.contour_field = field_of(*of_contours);
      if (scene_.contour_field.is_per_cell) {
        throw Error(fmt::format("'{}' is a field on cells, and has no contours",
                                scene_.contour_field.name),
                    of_contours->where, "name a field on points");
      }
    }
    scene_.mesh.point_fields.clear();
    scene_.mesh.cell_fields.clear();
    if (scene_.background.kind == BackgroundKind::picture) {
      read_background(scene_.background);
    }
    if (!behind_.empty()) {
      scene_.surfaces = read_surfaces(behind_, behind_where_);
    }
    return std::move(scene_);
  }

 private:
  /// What names a field, until the mesh has been read.
  struct FieldChoice {
    std::string name;
    std::optional<FieldPlace> place;
    std::optional<std::int64_t> component;
    std::string where;
  };

  std::optional<ConfigTable> table_of(const char* key, const char* hint) {
    std::optional<ConfigTable> table = root_.table(key);
    if (!table) {
      root_.problem(key, fmt::format("[{}] is missing", key),
                    fmt::format("add it, to {}: docs/reference/volume-scene.md", hint));
    }
    return table;
  }

  static FieldChoice choice_of(ConfigTable& table) {
    FieldChoice choice{.name = table.text("field"),
                       .place = std::nullopt,
                       .component = std::nullopt,
                       .where = table.where("field")};
    if (table.has("on")) {
      choice.place = table.one_of<FieldPlace>("on");
    }
    if (table.has("component")) {
      choice.component = table.integer("component", {.min = 0, .max = 1e6});
    }
    return choice;
  }

  /// The rows of `points`, whose first numbers ascend; empty: a problem.
  static std::vector<double> rows_of(ConfigTable& table, std::size_t n_columns) {
    std::vector<double> rows = table.matrix("points", 0, n_columns, kAnyValue);
    if (rows.empty() && !table.has_problems()) {
      table.problem("points", "a function without a row",
                    "give at least one: what is constant has one row");
    }
    for (std::size_t i = n_columns; i < rows.size(); i += n_columns) {
      if (!(rows[i] > rows[i - n_columns])) {
        table.problem("points",
                      fmt::format("the values of its rows must ascend, and {} follows {}",
                                  rows[i], rows[i - n_columns]),
                      "sort the rows by their first number, each value once");
        return {};
      }
    }
    for (std::size_t i = 0; i < rows.size(); ++i) {
      if (i % n_columns != 0 && rows[i] < 0.0) {
        table.problem("points", fmt::format("{} is negative", rows[i]),
                      "what follows the first number of a row is 0 or more");
        return {};
      }
    }
    return rows;
  }

  void read_density(ConfigTable& table) {
    const double scale = table.number_or("scale", 1.0, kPositive);
    const std::vector<double> rows = rows_of(table, 2);
    std::vector<double> breakpoints;
    std::vector<double> values;
    for (std::size_t i = 0; i + 1 < rows.size(); i += 2) {
      breakpoints.push_back(rows[i]);
      values.push_back(scale * rows[i + 1]);
    }
    if (!breakpoints.empty()) {
      scene_.density = {std::move(breakpoints), std::move(values)};
    }
  }

  void read_colour(ConfigTable& table) {
    scene_.glow = table.one_of_or("glow", Glow::chromaticity);
    const double scale = table.number_or("scale", 1.0, kPositive);
    const std::vector<double> rows = rows_of(table, 4);
    std::vector<double> breakpoints;
    std::vector<Eigen::Array3d> values;
    for (std::size_t i = 0; i + 3 < rows.size(); i += 4) {
      breakpoints.push_back(rows[i]);
      values.emplace_back(scale * rows[i + 1], scale * rows[i + 2], scale * rows[i + 3]);
    }
    if (!breakpoints.empty()) {
      scene_.colour = {std::move(breakpoints), std::move(values)};
    }
  }

  /// @param field  of the contours before it, and of this one
  void read_contour(ConfigTable& table, std::optional<FieldChoice>& field) {
    const FieldChoice own = choice_of(table);
    if (!field) {
      field = own;
    } else if (own.name != field->name || own.place != field->place ||
               own.component != field->component) {
      table.problem("field",
                    fmt::format("'{}' is not the field of the contours before it", own.name),
                    "all [[contour]] are of one field");
    }
    Contour contour;
    contour.value = table.number("value", kAnyValue);
    const std::vector<double> rgb = table.numbers("colour", 3, kPositive);
    contour.colour = {rgb[0], rgb[1], rgb[2]};
    contour.opacity = table.number("opacity", {.min = 0.0, .max = 1.0});
    contour.ambient = table.number_or("ambient", contour.ambient, kPositive);
    contour.diffuse = table.number_or("diffuse", contour.diffuse, kPositive);
    contour.specular = table.number_or("specular", contour.specular, kPositive);
    contour.exponent = table.number_or("exponent", contour.exponent, {.min = 0.0, .max = 1e6});
    scene_.contours.push_back(contour);
  }

  /// [background] and [behind]; files are only named.
  void read_backdrop() {
    std::optional<ConfigTable> table = root_.table("background");
    if (table) {
      read_background_table(*table);
    }
    if (std::optional<ConfigTable> behind = root_.table("behind")) {
      behind_ = folder_ / behind->text("picture");
      behind_where_ = behind->where("picture");
      if (table) {
        table->problem("", "a background behind the picture of [behind]",
                       "leave one of them out: that picture is all that is behind the medium");
      }
    }
  }

  void read_background_table(ConfigTable& table) {
    Background& background = scene_.background;
    const auto colour_of = [&](const char* key) -> Eigen::Array3d {
      const std::vector<double> rgb = table.numbers(key, 3, kPositive);
      return {rgb[0], rgb[1], rgb[2]};
    };
    int n_kinds = 0;
    if (table.has("top") || table.has("bottom")) {
      ++n_kinds;
      background.kind = BackgroundKind::gradient;
      background.colour = colour_of("top");
      background.other = colour_of("bottom");
    }
    if (table.has("checker") || table.has("square")) {
      ++n_kinds;
      background.kind = BackgroundKind::checker;
      const std::vector<double> rows = table.matrix("checker", 2, 3, kPositive);
      constexpr std::size_t kNumbers = 6;
      if (rows.size() == kNumbers) {
        background.colour = {rows[0], rows[1], rows[2]};
        background.other = {rows[3], rows[4], rows[5]};
      }
      background.square_px =
          static_cast<int>(table.integer("square", {.min = 1, .max = 1 << 16}));
    }
    if (table.has("picture")) {
      ++n_kinds;
      background.kind = BackgroundKind::picture;
      background.file = folder_ / table.text("picture");
      background.where = table.where("picture");
    }
    if (table.has("colour") || n_kinds == 0) {
      ++n_kinds;
      background.colour = colour_of("colour");
    }
    if (n_kinds > 1) {
      table.problem("", "more than one background",
                    "give colour; or top and bottom; or checker and square; or picture");
    }
  }

  void read_camera(ConfigTable& table) {
    const std::optional<CameraTable> read = read_camera_table(table);
    if (!read) {
      return;
    }
    scene_.camera = read->camera;
    scene_.optics = read->optics;
    if (!read->camera.distortion.isZero(0.0)) {
      table.problem("dist", "a volume is seen by a camera without distortion", "leave it out");
    }
    if (read->optics.lens_radius_mm > 0.0) {
      table.problem("lens_radius_mm", "a volume is seen by a camera without a lens",
                    "leave it out: all is sharp");
    }
  }

  [[nodiscard]] ScalarField field_of(const FieldChoice& choice) const {
    const CellMesh& mesh = scene_.mesh;
    const auto named = [&](const std::vector<MeshField>& fields) {
      return std::ranges::find(fields, choice.name, &MeshField::name);
    };
    const auto on_points = named(mesh.point_fields);
    const auto on_cells = named(mesh.cell_fields);
    const bool has_points =
        on_points != mesh.point_fields.end() && choice.place != FieldPlace::cells;
    if (!has_points &&
        (on_cells == mesh.cell_fields.end() || choice.place == FieldPlace::points)) {
      throw Error(
          fmt::format("{} has no field '{}'{}", scene_.mesh_file.string(), choice.name,
                      choice.place ? fmt::format(" on {}", to_string(*choice.place)) : ""),
          choice.where,
          fmt::format("its fields on points: {}; on cells: {}", names_of(mesh.point_fields),
                      names_of(mesh.cell_fields)));
    }
    const MeshField& field = has_points ? *on_points : *on_cells;
    const auto component = static_cast<std::size_t>(choice.component.value_or(0));
    if (field.n_components > 1 && !choice.component) {
      throw Error(fmt::format("'{}' has {} components", field.name, field.n_components),
                  choice.where, "say which: component = 0 is the first");
    }
    if (component >= field.n_components) {
      throw Error(fmt::format("'{}' has {}, and none of number {}", field.name,
                              counted(field.n_components, "component"), component),
                  choice.where, "count them from 0");
    }
    ScalarField made{.name = field.n_components > 1
                                 ? fmt::format("{}[{}]", field.name, component)
                                 : field.name,
                     .is_per_cell = !has_points,
                     .values = {}};
    made.values.reserve(field.values.size() / field.n_components);
    for (std::size_t i = component; i < field.values.size(); i += field.n_components) {
      if (!(std::abs(field.values[i]) <= kMaxValue)) {
        throw Error(fmt::format("'{}' is {} at {} {}", made.name, field.values[i],
                                has_points ? "point" : "cell", i / field.n_components),
                    scene_.mesh_file.string(),
                    fmt::format("give it a number within {:g} there", kMaxValue));
      }
      made.values.push_back(field.values[i]);
    }
    return made;
  }

  std::filesystem::path folder_;
  ConfigTable root_;
  VolumeScene scene_;
  std::filesystem::path behind_;
  std::string behind_where_;
};

}  // namespace

Eigen::Array3d light_behind(const VolumeScene& scene, int x, int y) {
  if (scene.surfaces) {
    const Image<float>& light = scene.surfaces->light;
    return {light(y, x, 0), light(y, x, 1), light(y, x, 2)};
  }
  return light_of(scene.background, x, y, scene.camera.height);
}

double depth_behind(const VolumeScene& scene, int x, int y) {
  return scene.surfaces ? std::min(static_cast<double>(scene.surfaces->depth(y, x)), kNoDepth)
                        : kNoDepth;
}

void require_sizes(const VolumeScene& scene) {
  const auto require = [&](const Image<float>& picture, const std::filesystem::path& file,
                           const std::string& where) {
    if (picture.width() != scene.camera.width || picture.height() != scene.camera.height) {
      throw Error(fmt::format("{} has {} x {} pixels, the picture of the volume {} x {}",
                              file.string(), picture.width(), picture.height(),
                              scene.camera.width, scene.camera.height),
                  where,
                  fmt::format("make it again with {0} x {1} pixels, or render the volume with "
                              "--size {2}x{3}",
                              scene.camera.width, scene.camera.height, picture.width(),
                              picture.height()),
                  ExitCode::bad_input);
    }
  };
  if (scene.background.kind == BackgroundKind::picture) {
    require(scene.background.picture, scene.background.file, scene.background.where);
  }
  if (scene.surfaces) {
    require(scene.surfaces->light, scene.surfaces->file, scene.surfaces->where);
  }
}

VolumeScene read_volume_scene(const std::filesystem::path& path) {
  return VolumeSceneReader(path).read();
}

}  // namespace haarlight::render
