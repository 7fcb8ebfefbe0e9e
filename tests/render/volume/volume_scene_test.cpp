// SPDX-License-Identifier: Apache-2.0
/// @file
/// Scene files of volumes: every key, and what is said about broken ones.

#include "render/volume/volume_scene.h"

#include <string>
#include <string_view>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/volume/volume_ray_caster.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using testing::TemporaryFolder;

/// Two tetrahedra with fields of every kind.
constexpr std::string_view kMesh = R"(<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">
<UnstructuredGrid><Piece NumberOfPoints="5" NumberOfCells="2">
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
0 0 0  1 0 0  0 1 0  0 0 1  1 1 1
</DataArray></Points>
<Cells>
<DataArray type="Int32" Name="connectivity" format="ascii">0 1 2 3 4 2 1 3</DataArray>
<DataArray type="Int32" Name="offsets" format="ascii">4 8</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">10 10</DataArray>
</Cells>
<PointData>
<DataArray type="Float64" Name="height" format="ascii">0 0.25 0.5 1 2</DataArray>
<DataArray type="Float64" Name="velocity" NumberOfComponents="3" format="ascii">
1 2 3  4 5 6  7 8 9  10 11 12  13 14 15
</DataArray>
<DataArray type="Float64" Name="both" format="ascii">1 2 3 4 5</DataArray>
<DataArray type="Float64" Name="broken" format="ascii">1 2 nan 4 5</DataArray>
<DataArray type="Float64" Name="huge" format="ascii">1 2 3 4 1e101</DataArray>
</PointData>
<CellData>
<DataArray type="Float64" Name="material" format="ascii">7 8</DataArray>
<DataArray type="Float64" Name="both" format="ascii">-1 -2</DataArray>
</CellData>
</Piece></UnstructuredGrid></VTKFile>
)";

/// Line by line, as errors count them.
constexpr std::string_view kScene = R"(schema = 1
name = "two cells"
[mesh]
file = "cells.vtu"
[density]
field = "height"
points = [[0, 0.5], [1, 2.5]]
[colour]
field = "height"
points = [[0, 1, 0, 0], [1, 0, 0, 1]]
[background]
colour = [0.25, 0.5, 0.75]
[camera]
size = [64, 48]
eye = [3, 2, 1]
target = [0.2, 0.3, 0.4]
fov_y_deg = 30
)";

std::string with(std::string text, std::string_view old, std::string_view by) {
  const std::size_t at = text.find(old);
  EXPECT_NE(at, std::string::npos) << "no '" << old << "' to replace";
  return text.replace(at, old.size(), by);
}
std::string scene_with(std::string_view old, std::string_view by) {
  return with(std::string(kScene), old, by);
}

VolumeScene read(const std::string& text, const std::string& mesh = std::string(kMesh)) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "cells.vtu", std::string_view(mesh));
  write_file_atomically(folder / "volume.toml", std::string_view(text));
  return read_volume_scene(folder / "volume.toml");
}

TEST(VolumeScene, ReadsEveryKey) {
  std::string text = with(
      scene_with("[[0, 0.5], [1, 2.5]]", "[[0, 0.5], [1, 2.5]]\nscale = 2\non = \"points\""),
      "[colour]\nfield = \"height\"",
      "[colour]\nfield = \"velocity\"\ncomponent = 2\non = \"points\"\n"
      "glow = \"own\"\nscale = 0.5");
  text += "up = [0, 1, 0]\nnear_mm = 0.5\nfar_mm = 7\n";
  const VolumeScene scene = read(text);
  EXPECT_EQ(scene.mesh_file.filename(), "cells.vtu");
  EXPECT_EQ(scene.mesh.n_cells(), 2U);
  EXPECT_TRUE(scene.mesh.point_fields.empty());
  EXPECT_EQ(scene.density_field.name, "height");
  EXPECT_FALSE(scene.density_field.is_per_cell);
  EXPECT_EQ(scene.density_field.values, (std::vector<double>{0.0, 0.25, 0.5, 1.0, 2.0}));
  EXPECT_EQ(scene.density.at(0.0), 1.0);
  EXPECT_EQ(scene.density.at(0.5), 3.0);
  EXPECT_EQ(scene.density.at(2.0), 5.0);
  EXPECT_EQ(scene.colour_field.name, "velocity[2]");
  EXPECT_EQ(scene.colour_field.values, (std::vector<double>{3.0, 6.0, 9.0, 12.0, 15.0}));
  EXPECT_EQ(scene.glow, Glow::own);
  EXPECT_TRUE((scene.colour.at(0.5) == Array3d(0.25, 0.0, 0.25)).all());
  EXPECT_TRUE((scene.background.colour == Array3d(0.25, 0.5, 0.75)).all());
  EXPECT_EQ(scene.camera.width, 64);
  EXPECT_EQ(scene.camera.height, 48);
  EXPECT_TRUE(scene.camera.centre_world().isApprox(Vector3d(3.0, 2.0, 1.0)));
  EXPECT_EQ(scene.optics.near_mm, 0.5);
  EXPECT_EQ(scene.optics.far_mm, 7.0);
  EXPECT_EQ(scene.optics.pixel_mm, 0.0);
}

TEST(VolumeScene, WhatIsLeftOutHasItsDefault) {
  const std::string text = with(
      with(std::string(kScene), "[colour]\nfield = \"height\"\n", ""),
      "points = [[0, 1, 0, 0], [1, 0, 0, 1]]\n[background]\ncolour = [0.25, 0.5, 0.75]\n", "");
  const VolumeScene scene = read(text);
  EXPECT_EQ(scene.colour_field.name, "height");  // white, whatever it is
  EXPECT_TRUE((scene.colour.at(0.3) == Array3d::Ones()).all());
  EXPECT_EQ(scene.glow, Glow::chromaticity);
  EXPECT_TRUE((scene.background.colour == Array3d::Zero()).all());
  EXPECT_EQ(scene.optics.far_mm, 0.0);
}

TEST(VolumeScene, AFieldIsThatOfThePointsUnlessTheFileSaysCells) {
  for (const std::string_view on : {"", "\non = \"points\""}) {
    const VolumeScene scene = read(scene_with("[density]\nfield = \"height\"",
                                              "[density]\nfield = \"both\"" + std::string(on)));
    EXPECT_FALSE(scene.density_field.is_per_cell);
    EXPECT_EQ(scene.density_field.values.size(), 5U);
  }
  const VolumeScene of_cells = read(scene_with("[density]\nfield = \"height\"",
                                               "[density]\nfield = \"both\"\non = \"cells\""));
  EXPECT_TRUE(of_cells.density_field.is_per_cell);
  EXPECT_EQ(of_cells.density_field.values, (std::vector<double>{-1.0, -2.0}));
  const VolumeScene only =
      read(scene_with("[density]\nfield = \"height\"", "[density]\nfield = \"material\""));
  EXPECT_TRUE(only.density_field.is_per_cell);
}

TEST(VolumeScene, TakesAParallelCameraAndOneByItsMatrices) {
  const VolumeScene parallel = read(scene_with("fov_y_deg = 30", "width_mm = 128"));
  EXPECT_EQ(parallel.optics.pixel_mm, 2.0);
  const VolumeScene matrices =
      read(scene_with("eye = [3, 2, 1]\ntarget = [0.2, 0.3, 0.4]\nfov_y_deg = 30",
                      "K = [[90, 0, 31], [0, 91, 25], [0, 0, 1]]\n"
                      "world_from_cam = [[1, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, -3]]\n"
                      "dist = [0, 0, 0, 0, 0]"));
  EXPECT_EQ(matrices.camera.fy, 91.0);
  EXPECT_EQ(matrices.camera.centre_world(), Vector3d(0.5, 0.25, -3.0));
}

struct Broken {
  std::string text;
  std::string where;  ///< the end of the file's name, and the line
  std::string problem;
  std::string hint;
};

/// One problem in each.
std::vector<Broken> broken_tables() {
  const std::string last(kScene);
  return {
      {scene_with("[mesh]\nfile = \"cells.vtu\"\n", ""), "volume.toml:1", "[mesh] is missing",
       "volume-scene.md"},
      {scene_with("file = \"cells.vtu\"\n", ""), "volume.toml:3", "mesh.file is missing",
       "add"},
      {scene_with("[density]\nfield = \"height\"\npoints = [[0, 0.5], [1, 2.5]]\n", ""),
       "volume.toml:1", "[density] is missing", "volume-scene.md"},
      {std::string(kScene.substr(0, kScene.find("[camera]"))), "volume.toml:1",
       "[camera] is missing", "volume-scene.md"},
      {scene_with("schema = 1", "schema = 2"), "volume.toml:1", "out of range", "from 1 to 1"},
      {scene_with("[density]\nfield", "[density]\nfeild"), "volume.toml:5",
       "density.field is missing", "did you mean field?"},
      {scene_with("[background]", "[backround]"), "volume.toml:11", "unknown key backround",
       "did you mean background?"},
      {scene_with("[mesh]", "[[mesh]]"), "volume.toml:3", "mesh is not a table",
       "write [mesh]"},
      {scene_with("size = [64, 48]\n", ""), "volume.toml:13", "camera.size is missing", "add"},
      {scene_with("size = [64, 48]", "size = [64, 70000]"), "volume.toml:14", "from 1 to 65536",
       "[width, height]"},
      {last + "lens_radius_mm = 4\nfocus_mm = 9\n", "volume.toml:18", "without a lens",
       "leave it out"},
      {last + "dist = [0.1, 0, 0, 0, 0]\n", "volume.toml:18", "without distortion",
       "leave it out"},
      {last + "near_mm = 9\nfar_mm = 8\n", "volume.toml:19", "sees nothing", "larger"},
      {last + "resolution = 3\n", "volume.toml:18", "unknown key camera.resolution",
       "remove it"},
      {last + "up = [-2.8, -1.7, -0.6]\n", "volume.toml:18", "its own up direction",
       "another up"},
      {scene_with("colour = [0.25, 0.5, 0.75]", "colour = [0.25, -0.5, 0.75]"),
       "volume.toml:12", "holds -0.5", "from 0 to"},
      {scene_with("colour = [0.25, 0.5, 0.75]", "colour = [0.25, 0.5]"), "volume.toml:12",
       "not a list of 3 numbers", "[number"},
  };
}

std::vector<Broken> broken_functions() {
  const auto density = [](std::string_view points) {
    return scene_with("[[0, 0.5], [1, 2.5]]", points);
  };
  const auto colour = [](std::string_view points) {
    return scene_with("[[0, 1, 0, 0], [1, 0, 0, 1]]", points);
  };
  return {
      {density("[[1, 0.5], [0, 2.5]]"), "volume.toml:7", "0 follows 1", "sort the rows"},
      {density("[[0, 0.5], [0, 2.5]]"), "volume.toml:7", "0 follows 0", "each value once"},
      {density("[[0, 0.5], [1, -2.5]]"), "volume.toml:7", "-2.5 is negative", "0 or more"},
      {density("[[0, 0.5, 1], [1, 2.5, 1]]"), "volume.toml:7", "not a matrix",
       "rows of 2 numbers"},
      {density("[[0, 0.5], [1, nan]]"), "volume.toml:7", "finite", "rows of 2 numbers"},
      {density("[[0, 0.5], [1, 1e101]]"), "volume.toml:7", "1e+101", "1e+100"},
      {density("[[-inf, 0.5], [1, 1]]"), "volume.toml:7", "finite", "rows of 2 numbers"},
      {density("\"steep\""), "volume.toml:7", "not a matrix", "rows of 2 numbers"},
      {density("[[0, 0.5], [1, 2.5]]\nscale = -1"), "volume.toml:8", "out of range",
       "from 0 to"},
      {colour("[[0, 1, 0], [1, 0, 0]]"), "volume.toml:10", "not a matrix", "rows of 4 numbers"},
      {colour("[[0, 1, 0, 0], [1, 0, -1, 1]]"), "volume.toml:10", "-1 is negative",
       "0 or more"},
      {colour("[[0, 1, 0, 0], [1, 0, 0, 1]]\nglow = \"bright\""), "volume.toml:11",
       "\"bright\" is not known", "\"chromaticity\" | \"own\""},
  };
}

std::vector<Broken> broken_fields() {
  const auto field = [](std::string_view words) {
    return scene_with("[density]\nfield = \"height\"",
                      "[density]\nfield = " + std::string(words));
  };
  return {
      {field("\"heihgt\""), "volume.toml:6", "no field 'heihgt'",
       "on points: 'height', 'velocity', 'both', 'broken', 'huge'; on cells: 'material', "
       "'both'"},
      {field("\"height\"\non = \"cells\""), "volume.toml:6", "no field 'height' on cells",
       "on points: 'height'"},
      {field("\"material\"\non = \"points\""), "volume.toml:6", "no field 'material' on points",
       "on cells: 'material'"},
      {field("\"height\"\non = \"faces\""), "volume.toml:7", "\"faces\" is not known",
       "\"points\" | \"cells\""},
      {field("\"velocity\""), "volume.toml:6", "'velocity' has 3 components",
       "component = 0 is the first"},
      {field("\"velocity\"\ncomponent = 3"), "volume.toml:6", "none of number 3",
       "count them from 0"},
      {field("\"velocity\"\ncomponent = -1"), "volume.toml:7", "out of range", "from 0"},
      {field("\"height\"\ncomponent = 1"), "volume.toml:6", "has 1 component,",
       "count them from 0"},
      {field("\"broken\""), "cells.vtu", "'broken' is nan at point 2", "a number within"},
      {field("\"huge\""), "cells.vtu", "'huge' is 1e+101 at point 4", "within 1e+100"},
      {scene_with("cells.vtu", "absent.vtu"), "absent.vtu", "", ""},
      {scene_with("cells.vtu", "volume.toml"), "volume.toml", "", ".vtu"},
  };
}

TEST(VolumeScene, SaysWhatIsWrongWhereAndWhatToDo) {
  std::size_t n = 0;
  for (const std::vector<Broken>& group :
       {broken_tables(), broken_functions(), broken_fields()}) {
    for (const Broken& broken : group) {
      try {
        static_cast<void>(read(broken.text));
        ADD_FAILURE() << "no error of:\n" << broken.text;
      } catch (const Error& error) {
        EXPECT_TRUE(error.where().ends_with(broken.where))
            << error.what() << "\nnot at " << broken.where;
        EXPECT_NE(error.problem().find(broken.problem), std::string::npos)
            << error.what() << "\nwithout: " << broken.problem;
        EXPECT_NE(error.hint().find(broken.hint), std::string::npos)
            << error.what() << "\nwithout: " << broken.hint;
        EXPECT_FALSE(error.hint().empty()) << error.what();
      }
      ++n;
    }
  }
  EXPECT_GE(n, 40U);
}

TEST(VolumeScene, RefusesFunctionsWithoutARow) {
  for (const std::string_view points :
       {"[[0, 0.5], [1, 2.5]]", "[[0, 1, 0, 0], [1, 0, 0, 1]]"}) {
    try {
      static_cast<void>(read(scene_with(points, "[]")));
      ADD_FAILURE() << "no error, and a medium that nobody described";
    } catch (const Error& error) {
      EXPECT_NE(error.where().find("volume.toml:"), std::string::npos) << error.what();
    }
  }
}

TEST(VolumeScene, SaysAllProblemsAtOnce) {
  try {
    static_cast<void>(read(with(scene_with("[[0, 0.5], [1, 2.5]]", "[[1, 0.5], [0, 2.5]]"),
                                "size = [64, 48]", "size = [64]")));
    FAIL() << "no error";
  } catch (const Error& error) {
    const std::string said = error.what();
    EXPECT_NE(said.find("volume.toml:7"), std::string::npos) << said;
    EXPECT_NE(said.find("volume.toml:14"), std::string::npos) << said;
  }
}

TEST(VolumeScene, RefusesMeshesThatCannotBeRendered) {
  const std::string mesh(kMesh);
  const std::string text(kScene);
  const auto refused = [&](const std::string& broken, const std::string& problem) {
    try {
      static_cast<void>(read(text, broken));
      ADD_FAILURE() << "no error: " << problem;
    } catch (const Error& error) {
      EXPECT_NE(error.problem().find(problem), std::string::npos) << error.what();
      EXPECT_NE(error.where().find("cells.vtu"), std::string::npos) << error.what();
      EXPECT_FALSE(error.hint().empty()) << error.what();
    }
  };
  refused(with(mesh, "0 1 2 3 4 2 1 3", "0 2 1 3 4 2 1 3"), "cell 0, a tetrahedron,");
  refused(with(mesh, "0 1 2 3 4 2 1 3", "0 1 2 1 4 2 1 3"), "cell 0, a tetrahedron,");
  refused(with(mesh, "0 1 2 3 4 2 1 3", "0 1 2 9 4 2 1 3"), "");
  refused(with(mesh, "1 1 1\n", "1 1 nan\n"), "point 4 is not finite");
  refused(with(mesh, "10 10<", "10 42<"), "");
  refused("no mesh", "");
}

TEST(VolumeScene, TheLargestOpticalDepthsAreRefused) {
  const VolumeScene scene =
      read(scene_with("[[0, 0.5], [1, 2.5]]", "[[0, 0.5], [1, 1e100]]\nscale = 1e100"));
  EXPECT_NO_THROW(VolumeRayCaster(scene, {}));
  VolumeScene huge = scene;
  for (Vector3d& point : huge.mesh.points) {
    point *= 1e110;
  }
  EXPECT_THROW(VolumeRayCaster(huge, {}), Error);
}

}  // namespace
}  // namespace haarlight::render
