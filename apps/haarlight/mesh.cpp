// SPDX-License-Identifier: Apache-2.0
/// @file
/// `haarlight mesh info FILE`: what a mesh of cells holds, and whether it can be rendered.
/// `haarlight mesh convert FILE -o OUT.vtu`: the same mesh for programs that read VTK's files.

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "apps/haarlight/render_scene.h"
#include "apps/haarlight/verb.h"
#include "core/counted.h"
#include "haarlight/core/files.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"
#include "render/cell_mesh/vtu_writer.h"

namespace haarlight::apps {

namespace {

using Json = nlohmann::ordered_json;

struct MeshArguments {
  std::string file;
  std::string output;  ///< of convert
  std::string solution;
  std::optional<render::MeshFormat> format;
  bool is_json = false;
};

/// Of a field's finite values, over all components.
struct FieldRange {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  std::size_t n_not_finite = 0;
};

FieldRange range_of(const render::MeshField& field) {
  FieldRange range;
  for (const double value : field.values) {
    if (!std::isfinite(value)) {
      ++range.n_not_finite;
      continue;
    }
    range.low = std::min(range.low, value);
    range.high = std::max(range.high, value);
  }
  return range;
}

std::string fields_text(const std::vector<render::MeshField>& fields, std::string_view place) {
  std::string text;
  for (const render::MeshField& field : fields) {
    const FieldRange range = range_of(field);
    const std::string values = range.low <= range.high
                                   ? fmt::format("{:.6g} to {:.6g}", range.low, range.high)
                                   : "no values";
    text += fmt::format("{} '{}': {}, {}", place, field.name,
                        counted(field.n_components, "component"), values);
    text += range.n_not_finite > 0 ? fmt::format(", {} not finite", range.n_not_finite) : "";
    text += '\n';
  }
  return text;
}

std::string cells_text(const render::CellMesh& mesh, const render::MeshCheck& check) {
  std::string text = fmt::format("cells: {}", mesh.n_cells());
  std::string_view before = ": ";
  for (std::size_t i = 0; i < render::kCellTypes; ++i) {
    if (check.n_of_type.at(i) > 0) {
      text += fmt::format("{}{} {}", before, check.n_of_type.at(i),
                          shape_of(static_cast<render::CellType>(i)).name);
      before = ", ";
    }
  }
  return text + '\n';
}

/// A line for each thing that is there.
std::string findings_text(const render::CellMesh& mesh, const render::MeshCheck& check) {
  std::string text;
  const auto add = [&text](std::size_t n, const std::string& what) {
    text += n > 0 ? fmt::format("{}: {}\n", what, n) : "";
  };
  add(check.n_crowded_faces, "faces of more than two cells (they overlap)");
  add(check.n_non_planar_faces,
      fmt::format("faces that are not planar (by up to {:.3g})", check.largest_deviation));
  add(check.n_curved_cells,
      fmt::format("cells with bent edges or sides (by up to {:.3g})", check.largest_bend));
  add(check.n_collapsed_cells, "cells that repeat a node");
  add(mesh.n_other_wedges, "wedges not in VTK's order (read all the same)");
  add(mesh.n_left_out, "points, lines and surfaces (left out)");
  add(mesh.n_blanked, "cells with a blanked corner (left out)");
  add(mesh.n_turned, "cells of left-handed grids (turned)");
  add(check.n_unused_points, "points of no solid cell");
  for (const std::string& note : mesh.notes) {
    text += note + '\n';
  }
  return text;
}

render::MeshFormat format_of(const MeshArguments& arguments) {
  return arguments.format ? *arguments.format : render::mesh_format(arguments.file);
}

std::string info_text(const MeshArguments& arguments, const render::CellMesh& mesh,
                      const render::MeshCheck& check) {
  return fmt::format(
             "{}: {}\npoints: {}\n{}box: ({:.6g}, {:.6g}, {:.6g}) to ({:.6g}, {:.6g}, {:.6g})\n"
             "volume: {:.9g}, cells from {:.3g} to {:.3g}\nfaces: {}, {} on the boundary\n"
             "parts: {}\n",
             arguments.file, to_string(format_of(arguments)), mesh.points.size(),
             cells_text(mesh, check), check.low.x(), check.low.y(), check.low.z(),
             check.high.x(), check.high.y(), check.high.z(), check.volume,
             check.smallest_volume, check.largest_volume, check.n_faces, check.n_boundary_faces,
             check.n_parts) +
         findings_text(mesh, check) + fields_text(mesh.point_fields, "point field") +
         fields_text(mesh.cell_fields, "cell field");
}

Json fields_json(const std::vector<render::MeshField>& fields) {
  Json list = Json::array();
  for (const render::MeshField& field : fields) {
    const FieldRange range = range_of(field);
    Json item = {{"name", field.name}, {"components", field.n_components}};
    item["range"] = range.low <= range.high ? Json({range.low, range.high}) : Json(nullptr);
    item["not_finite"] = range.n_not_finite;
    list.push_back(std::move(item));
  }
  return list;
}

Json info_json(const MeshArguments& arguments, const render::CellMesh& mesh,
               const render::MeshCheck& check) {
  Json types = Json::object();
  for (std::size_t i = 0; i < render::kCellTypes; ++i) {
    types[std::string(shape_of(static_cast<render::CellType>(i)).name)] = check.n_of_type.at(i);
  }
  return {{"file", arguments.file},
          {"format", to_string(format_of(arguments))},
          {"points", mesh.points.size()},
          {"cells", mesh.n_cells()},
          {"types", types},
          {"low", {check.low.x(), check.low.y(), check.low.z()}},
          {"high", {check.high.x(), check.high.y(), check.high.z()}},
          {"volume", check.volume},
          {"smallest_cell", check.smallest_volume},
          {"largest_cell", check.largest_volume},
          {"faces", check.n_faces},
          {"boundary_faces", check.n_boundary_faces},
          {"crowded_faces", check.n_crowded_faces},
          {"non_planar_faces", check.n_non_planar_faces},
          {"largest_deviation", check.largest_deviation},
          {"curved_cells", check.n_curved_cells},
          {"largest_bend", check.largest_bend},
          {"collapsed_cells", check.n_collapsed_cells},
          {"parts", check.n_parts},
          {"other_wedges", mesh.n_other_wedges},
          {"left_out", mesh.n_left_out},
          {"blanked", mesh.n_blanked},
          {"turned", mesh.n_turned},
          {"unused_points", check.n_unused_points},
          {"point_fields", fields_json(mesh.point_fields)},
          {"cell_fields", fields_json(mesh.cell_fields)},
          {"notes", mesh.notes}};
}

render::CellMesh read_mesh(const MeshArguments& arguments, Report& report) {
  report.add_input(arguments.file);
  if (!arguments.solution.empty()) {
    report.add_input(arguments.solution);
  }
  return render::read_cell_mesh(arguments.file,
                                {.format = arguments.format, .solution = arguments.solution});
}

ExitCode run_mesh_info(const MeshArguments& arguments, Report& report) {
  const render::CellMesh mesh = read_mesh(arguments, report);
  const render::MeshCheck check = render::check_cell_mesh(mesh, arguments.file);
  report.add_achieved("cells", static_cast<std::int64_t>(mesh.n_cells()));
  report.add_achieved("points", static_cast<std::int64_t>(mesh.points.size()));
  report.add_achieved("volume", check.volume);
  if (arguments.is_json) {
    // A name that is not UTF-8 is shown with marks in its place.
    fmt::print(
        "{}\n",
        info_json(arguments, mesh, check).dump(2, ' ', false, Json::error_handler_t::replace));
  } else {
    fmt::print("{}", info_text(arguments, mesh, check));
  }
  return ExitCode::done;
}

ExitCode run_mesh_convert(const MeshArguments& arguments, const CommonOptions& common,
                          Report& report) {
  if (!has_ending(arguments.output, ".vtu")) {
    throw Error("no name of a mesh that is written", arguments.output, "end it in .vtu",
                ExitCode::usage);
  }
  require_absent(arguments.output, common.force);
  const render::CellMesh mesh = read_mesh(arguments, report);
  const render::MeshCheck check = render::check_cell_mesh(mesh, arguments.file);
  render::write_vtu(mesh, arguments.output);
  report.add_achieved("cells", static_cast<std::int64_t>(mesh.n_cells()));
  report.add_achieved("points", static_cast<std::int64_t>(mesh.points.size()));
  report.set_bytes(std::filesystem::file_size(arguments.output));
  fmt::print("{}: {}, {}{}", arguments.output, counted(mesh.points.size(), "point"),
             cells_text(mesh, check), findings_text(mesh, check));
  return ExitCode::done;
}

void add_mesh_options(Command verb, MeshArguments& arguments) {
  verb.option("FILE", &arguments.file,
              "Mesh: .vtu, .vtk of VTK's legacy format, .msh of gmsh (4.1), .xyz .x .g .p3d a "
              "PLOT3D grid",
              {.type = "MESH", .is_required = true});
  verb.option("--solution", &arguments.solution, "PLOT3D solution (q) on the grid",
              {.type = "Q"});
  verb.option("--format", &arguments.format, "Of a file whose ending does not tell it",
              {.default_text = "by the ending"});
}

void add_mesh_convert(Command mesh, Invocation& invocation) {
  auto arguments = std::make_shared<MeshArguments>();
  Command verb = mesh.add_verb(
      "convert", "Write a mesh and its fields as VTK's .vtu, for ParaView and others");
  add_mesh_options(verb, *arguments);
  verb.option("-o,--output", &arguments->output, "Mesh to write",
              {.type = "OUT.vtu", .is_required = true});
  verb.footer(
      "Points, cells and fields keep their order, in double precision. What `mesh info` "
      "refuses "
      "is\nrefused here.\n\n"
      "Example:\n"
      "  haarlight mesh convert configs/volumes/duct.xyz -o duct.vtu \\\n"
      "      --solution configs/volumes/duct.q");
  finish_verb(verb, invocation, [arguments](const CommonOptions& common, Report& report) {
    return run_mesh_convert(*arguments, common, report);
  });
}

}  // namespace

void add_mesh(Command root, Invocation& invocation) {
  Command mesh = root.add_verb("mesh", "Meshes of cells: the volumes of other programs");
  mesh.require_verb();
  auto arguments = std::make_shared<MeshArguments>();
  Command info =
      mesh.add_verb("info", "Tell what a mesh holds, and whether it can be rendered");
  add_mesh_options(info, *arguments);
  info.flag("--json", &arguments->is_json, "Print it as JSON");
  info.footer(
      "Refuses, by the cell's number, what cannot be rendered: cells that are flat, inverted "
      "or\n"
      "name points that are not there. What stands out otherwise is counted.\n\n"
      "Examples:\n"
      "  haarlight mesh info configs/volumes/four_cells.vtu\n"
      "  haarlight mesh info configs/volumes/four_cells.vtu --json\n"
      "  haarlight mesh info configs/volumes/duct.xyz --solution configs/volumes/duct.q");
  finish_verb(info, invocation, [arguments](const CommonOptions&, Report& report) {
    return run_mesh_info(*arguments, report);
  });
  add_mesh_convert(mesh, invocation);
}

}  // namespace haarlight::apps
