// SPDX-License-Identifier: Apache-2.0
/// @file
/// Meshes that others' programs wrote (gmsh through VTK, ParaView, MATLAB), where they are.

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <map>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "render/cell_mesh/cell_mesh_check.h"
#include "render/cell_mesh/cell_mesh_io.h"

namespace haarlight::render {
namespace {

using Eigen::Vector3d;
using ::testing::HasSubstr;

class SharedMeshes : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(HAARLIGHT_SOURCE_DIR) / "../shared/data/volume";
    if (!std::filesystem::exists(folder_)) {
      GTEST_SKIP() << "no ../shared/data/volume here";
    }
  }
  [[nodiscard]] CellMesh read(const std::string& name) const {
    return read_cell_mesh(folder_ / name);
  }

  std::filesystem::path folder_;
};

const MeshField& field_of(const CellMesh& mesh, std::string_view name) {
  for (const MeshField& field : mesh.point_fields) {
    if (field.name == name) {
      return field;
    }
  }
  throw std::runtime_error("no field " + std::string(name));
}

double linear(const Vector3d& x) { return (x[0] + 2 * x[1] + 3 * x[2]) / 6; }
double quadratic(const Vector3d& x) {
  return 0.9 -
         1.6 * (std::pow(x[0] - 0.45, 2) + 0.8 * std::pow(x[1] - 0.55, 2) +
                1.2 * std::pow(x[2] - 0.5, 2)) +
         0.3 * x[0] * x[1] - 0.2 * x[1] * x[2];
}

/// Largest difference from the formula, over the points.
double off(const CellMesh& mesh, std::string_view name,
           const std::function<double(const Vector3d&)>& formula) {
  const MeshField& field = field_of(mesh, name);
  double largest = 0.0;
  for (std::size_t i = 0; i < mesh.points.size(); ++i) {
    largest = std::max(largest, std::abs(field.values[i] - formula(mesh.points[i])));
  }
  return largest;
}

TEST_F(SharedMeshes, GmshsBoxesAndHolesAreAsTheirDescriptionsSay) {
  for (const std::string name : {"box_tet_lin_small", "box_tet_lin_163k", "box_tet_quad_10k",
                                 "hole_tet_lin", "hole_tet_quad"}) {
    SCOPED_TRACE(name);
    const std::string file = (folder_ / (name + ".json")).string();
    const nlohmann::json said = nlohmann::json::parse(read_file(file));
    const CellMesh mesh = read(name + ".vtu");
    const MeshCheck check = check_cell_mesh(mesh, name);
    EXPECT_EQ(mesh.points.size(), said["points"].get<std::size_t>());
    EXPECT_EQ(mesh.n_cells(), said["cells"].get<std::size_t>());
    EXPECT_EQ(check.n_of_type[said["order"] == 1 ? 0 : 4], mesh.n_cells());
    // Sums of up to 163 193 cells, each rounded.
    EXPECT_NEAR(check.volume, said["total_vol"].get<double>(), 1e-13);
    EXPECT_NEAR(check.smallest_volume, said["min_vol"].get<double>(), 1e-18);
    EXPECT_EQ(check.low, Vector3d(0, 0, 0));
    EXPECT_EQ(check.high, Vector3d(1, 1, 1));
    EXPECT_EQ(check.n_parts, 1U);
    EXPECT_EQ(check.n_curved_cells, 0U);
    EXPECT_EQ(check.n_crowded_faces, 0U);
    EXPECT_EQ(check.n_unused_points, 0U);
    EXPECT_EQ(2 * check.n_faces - check.n_boundary_faces, 4 * mesh.n_cells());
    // Some roundings of numbers about 1.
    EXPECT_LE(off(mesh, "linear", linear), 1e-15);
    EXPECT_LE(off(mesh, "quadratic", quadratic), 4e-15);
  }
}

TEST_F(SharedMeshes, TheZooIsACubeWithItsField) {
  const std::string file = (folder_ / "zoo_mixed_8.json").string();
  const nlohmann::json said = nlohmann::json::parse(read_file(file));
  const CellMesh mesh = read("zoo_mixed_8.vtu");
  const MeshCheck check = check_cell_mesh(mesh, "zoo");
  const nlohmann::json& mix = said["cell_mix"];
  EXPECT_EQ(mesh.n_cells(), said["cells"].get<std::size_t>());
  EXPECT_EQ(mesh.points.size(), said["points"].get<std::size_t>());
  // Of the cubes of the mix: bricks as they are, in two wedges, three or six pyramids, five or
  // six tetrahedra.
  EXPECT_EQ(check.n_of_type[0],
            5 * mix["tet5"].get<std::size_t>() + 6 * mix["tet6"].get<std::size_t>());
  EXPECT_EQ(check.n_of_type[1], mix["hex"].get<std::size_t>());
  EXPECT_EQ(check.n_of_type[2], 2 * mix["wedge"].get<std::size_t>());
  EXPECT_EQ(check.n_of_type[3],
            3 * mix["pyr3"].get<std::size_t>() + 6 * mix["pyr6"].get<std::size_t>());
  EXPECT_EQ(mesh.n_other_wedges, 0U);
  EXPECT_NEAR(check.volume, said["total_vol"].get<double>(), 1e-13);
  EXPECT_EQ(check.n_non_planar_faces, 0U);
  EXPECT_LE(off(mesh, "linear", linear), 1e-15);
}

TEST_F(SharedMeshes, LegacyFilesOfOthers) {
  const CellMesh example = read("vtkdata_uGridEx.vtk");
  const MeshCheck check = check_cell_mesh(example, "uGridEx");
  EXPECT_EQ(check.n_of_type[0], 2U);
  EXPECT_EQ(check.n_of_type[1], 2U);
  EXPECT_EQ(example.n_left_out, 8U);
  EXPECT_NEAR(check.volume, 2.0 + 2.0 / 6, 1e-15);
  EXPECT_EQ(field_of(example, "scalars").values[26], 26.0);
  EXPECT_EQ(field_of(example, "vectors").n_components, 3U);

  const CellMesh hexahedra = read("vtkdata_hexa.vtk");
  EXPECT_EQ(check_cell_mesh(hexahedra, "hexa").n_of_type[1], 10648U);

  // The same cylinder with and without middles of edges, binary.
  const CellMesh straight = read("vtkdata_Quadratic_CylinderLinear.vtk");
  const CellMesh ten = read("vtkdata_Quadratic_CylinderQuadratic.vtk");
  EXPECT_EQ(straight.n_cells(), 1522U);
  EXPECT_EQ(ten.n_cells(), 1522U);
  EXPECT_EQ(field_of(ten, "velocity").n_components, 3U);
  EXPECT_EQ(ten.cell_fields.size(), 4U);
  const MeshField& velocity = field_of(ten, "velocity");
  const MeshField& norm = field_of(ten, "velocity_norm");
  for (std::size_t i = 0; i < ten.points.size(); ++i) {
    const Vector3d v(velocity.values[3 * i], velocity.values[3 * i + 1],
                     velocity.values[3 * i + 2]);
    ASSERT_NEAR(v.norm(), norm.values[i], 1e-12) << i;
  }
  EXPECT_NEAR(check_cell_mesh(ten, "ten").volume, check_cell_mesh(straight, "straight").volume,
              1e-18);
}

TEST_F(SharedMeshes, XmlFilesOfOthers) {
  const CellMesh cube = read("vtkdata_QuadraticTetra.vtu");
  const MeshCheck cube_check = check_cell_mesh(cube, "QuadraticTetra");
  EXPECT_EQ(cube_check.n_of_type[4], 96U);
  EXPECT_NEAR(cube_check.volume, 8.0, 1e-12);
  EXPECT_EQ(cube_check.n_curved_cells, 0U);

  const CellMesh kiefer = read("vtkdata_fea_kiefer_dataset.vtu");
  const MeshCheck kiefer_check = check_cell_mesh(kiefer, "kiefer");
  EXPECT_EQ(kiefer_check.n_of_type[4], 56786U);
  EXPECT_EQ(kiefer.points.size(), 102578U);
  EXPECT_GT(kiefer_check.n_curved_cells, 50000U);  // Float32 middles, and a bent surface
  EXPECT_GT(kiefer_check.largest_bend, 0.01);
  EXPECT_TRUE(kiefer.point_fields.empty());
  EXPECT_EQ(kiefer.cell_fields.size(), 1U);

  const CellMesh bent = read("vtkdata_quadraticTetra01.vtu");
  EXPECT_EQ(bent.n_left_out, 2U);
  // Its Jacobian is -0.064 at corner 2.
  EXPECT_EQ(folding_of(bent, 0), Folding::folded);
  EXPECT_THROW(static_cast<void>(check_cell_mesh(bent, "quadraticTetra01")), Error);

  const CellMesh wedges = read("vtkdata_QuadraticWedge.vtu");
  const MeshCheck wedge_check = check_cell_mesh(wedges, "QuadraticWedge");
  EXPECT_EQ(wedge_check.n_of_type[7], 16U);
  EXPECT_NEAR(wedge_check.volume, 8.0, 1e-12);
  EXPECT_EQ(wedge_check.n_curved_cells, 0U);

  const CellMesh pyramids = read("vtkdata_QuadraticPyramid.vtu");
  const MeshCheck pyramid_check = check_cell_mesh(pyramids, "QuadraticPyramid");
  EXPECT_EQ(pyramid_check.n_of_type[8], 48U);
  EXPECT_NEAR(pyramid_check.volume, 8.0, 1e-12);
  EXPECT_EQ(pyramid_check.n_curved_cells, 0U);

  const CellMesh notch = read("vtkdata_notch_disp.vtu");
  const MeshCheck notch_check = check_cell_mesh(notch, "notch_disp");
  EXPECT_EQ(notch_check.n_of_type[5], 2188U);
  EXPECT_EQ(notch.n_cells(), 2192U);

  const CellMesh can = read("vtkdata_can.vtu");
  EXPECT_EQ(can.n_cells(), 4800U);
  EXPECT_EQ(can.points.size(), 6724U);
  EXPECT_EQ(field_of(can, "DISPL").n_components, 3U);
}

TEST_F(SharedMeshes, GmshsOwnFilesAreTheUnitCube) {
  const auto square = [](const Vector3d& x) {
    return x[0] * x[0] + x[1] * x[2] - 0.5 * x[0] * x[1];
  };
  struct Cube {
    std::string name;
    CellType type;
    std::size_t n_points;
    std::size_t n_cells;
  };
  for (const Cube& cube : {Cube{"tet4", CellType::tetrahedron, 45, 100},
                           Cube{"tet4_binary", CellType::tetrahedron, 45, 100},
                           Cube{"tet10", CellType::quadratic_tetrahedron, 231, 100},
                           Cube{"tet20", CellType::cubic_tetrahedron, 659, 100},
                           Cube{"hex8", CellType::hexahedron, 27, 8},
                           Cube{"hex20", CellType::quadratic_hexahedron, 81, 8},
                           Cube{"hex20_binary", CellType::quadratic_hexahedron, 81, 8},
                           Cube{"prism6", CellType::wedge, 36, 28},
                           Cube{"prism15", CellType::quadratic_wedge, 135, 28}}) {
    SCOPED_TRACE(cube.name);
    const CellMesh mesh = read("gmsh/" + cube.name + ".msh");
    const MeshCheck check = check_cell_mesh(mesh, cube.name);
    EXPECT_EQ(mesh.points.size(), cube.n_points);
    EXPECT_EQ(mesh.n_cells(), cube.n_cells);
    EXPECT_EQ(check.n_of_type.at(static_cast<std::size_t>(cube.type)), cube.n_cells);
    EXPECT_EQ(check.n_unused_points, 0U);
    EXPECT_EQ(check.n_crowded_faces, 0U);
    if (cube.name.starts_with("hex20") || cube.name == "prism15") {
      // gmsh's own nodes inside are off by that; of a wrong order they would be by a tenth.
      EXPECT_LE(check.largest_bend, 2e-12);
    } else {
      EXPECT_EQ(check.n_curved_cells, 0U);
    }
    EXPECT_EQ(mesh.numbers_in_file.front(), 1U);
    EXPECT_NEAR(check.volume, 1.0, 1e-14);  // a sum of 100 cells, each rounded
    if (cube.name.ends_with("_binary")) {
      const std::string text = cube.name.substr(0, cube.name.find('_'));
      EXPECT_TRUE(mesh.point_fields.empty());
      EXPECT_EQ(mesh.nodes, read("gmsh/" + text + ".msh").nodes);
      continue;
    }
    // Roundings of numbers about 1.
    EXPECT_LE(off(mesh, "linear", linear), 1e-15);
    EXPECT_LE(off(mesh, "quadratic", square), 1e-15);
  }
}

TEST_F(SharedMeshes, Plot3dGridsWithTheirSolutions) {
  const auto read_pair = [this](const std::string& name) {
    return read_cell_mesh(
        folder_ / ("vtkdata_" + name + "xyz.bin"),
        {.format = MeshFormat::plot3d, .solution = folder_ / ("vtkdata_" + name + "q.bin")});
  };
  const CellMesh fin = read_pair("bluntfin");
  const MeshCheck fin_check = check_cell_mesh(fin, "bluntfin");
  EXPECT_EQ(fin.points.size(), 40960U);
  EXPECT_EQ(fin.n_cells(), 37479U);
  // Volumes: a sum of Gauss points in numpy, of coordinates of single precision.
  EXPECT_NEAR(fin_check.volume, 931.162696399, 1e-8);
  EXPECT_THAT(fin.notes, ::testing::Contains(HasSubstr("484 zero bytes behind the end, from "
                                                       "byte 819228 on")));
  EXPECT_THAT(fin.notes, ::testing::Contains(HasSubstr("Mach 2.95, angle of attack 0")));
  const MeshField& density = field_of(fin, "density");
  EXPECT_EQ(*std::max_element(density.values.begin(), density.values.end()), 4.9775F);
  EXPECT_EQ(*std::min_element(density.values.begin(), density.values.end()), 0.1926F);
  EXPECT_EQ(field_of(fin, "momentum").n_components, 3U);

  const CellMesh post = read_pair("post");
  EXPECT_EQ(post.points.size(), 109744U);
  EXPECT_EQ(post.n_cells(), 102675U);
  EXPECT_EQ(post.n_blanked, 0U);  // its iblank is 1 or -1
  EXPECT_NEAR(check_cell_mesh(post, "post").volume, 3399.66220521, 1e-6);
  EXPECT_THAT(post.notes.front(), HasSubstr("single precision, iblank"));

  const CellMesh comb = read_pair("comb");
  EXPECT_EQ(comb.points.size(), 47025U);
  EXPECT_EQ(comb.n_cells(), 43008U);
  EXPECT_THROW(static_cast<void>(check_cell_mesh(comb, "comb")), Error);  // two bent corners
}

TEST_F(SharedMeshes, RefusedOnesAreNamed) {
  const std::map<std::string, std::string> refused = {
      {"vtkdata_PentaHexa.vtk", "cell 0 is a pentagonal prism (VTK's type 15)"},
      {"vtkdata_blow.vtk", "no solid cells"},                      // a car's bumper of shells
      {"vtkdata_can.vtu", "cell 195, a hexahedron, is inverted"},  // crushed by its impact
      {"vtkdata_tetraMesh.vtk", "cell 4, a tetrahedron, is inverted"}};
  for (const auto& [name, what] : refused) {
    try {
      static_cast<void>(check_cell_mesh(read(name), name));
      ADD_FAILURE() << name;
    } catch (const Error& error) {
      EXPECT_THAT(error.problem(), HasSubstr(what));
      EXPECT_THAT(error.where(), HasSubstr(name));
    }
  }
}

}  // namespace
}  // namespace haarlight::render
