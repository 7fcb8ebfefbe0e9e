// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/shape/surface_mesh.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::TemporaryFolder;

struct Sheet {
  Image<float> points{5, 7, 3};
  Image<std::uint8_t> known{5, 7, 1};
  Image<std::uint8_t> cut{5, 7, 2};
  Image<float> normals{5, 7, 3};
  Image<float> albedo{5, 7, 1};
};

Sheet sheet() {
  Sheet s;
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      s.points(y, x, 0) = static_cast<float>(x) - 3.0F;
      s.points(y, x, 1) = 2.0F - static_cast<float>(y);
      s.points(y, x, 2) = 0.1F * static_cast<float>(x * x + y);
      s.normals(y, x, 2) = 1.0F;
      s.known(y, x) = 1;
      s.albedo(y, x) = 0.5F;
    }
  }
  return s;
}

render::SurfaceMesh mesh_of(const Sheet& s, const SurfaceMeshOptions& options = {}) {
  return make_surface_mesh(s.points.view(), s.known.view(), s.cut.view(), s.normals.view(),
                           s.albedo.view(), options);
}

TEST(SurfaceMesh, HasTwoTrianglesASquareTurnedToTheCamera) {
  const render::SurfaceMesh mesh = mesh_of(sheet());
  EXPECT_EQ(mesh.vertices.size(), 35U);
  EXPECT_EQ(mesh.triangles.size(), 2U * 4U * 6U);
  double area = 0.0;
  for (const auto& triangle : mesh.triangles) {
    std::array<Vector3d, 3> p;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto& v = mesh.vertices[triangle[i]];
      p[i] = {double{v[0]}, double{v[1]}, double{v[2]}};
    }
    const Vector3d across = (p[1] - p[0]).cross(p[2] - p[0]);
    EXPECT_GT(across.z(), 0.0);
    area += 0.5 * across.z();
  }
  EXPECT_NEAR(area, 24.0, 1e-5);  // seen from above each point is covered once
}

TEST(SurfaceMesh, ComesBackFromPlyAndObj) {
  const TemporaryFolder folder;
  const render::SurfaceMesh mesh = mesh_of(sheet());
  render::write_ply(mesh, folder / "mesh.ply");
  render::write_obj(mesh, folder / "mesh.obj", "albedo.png");
  EXPECT_NE(read_file(folder / "mesh.mtl").find("map_Kd albedo.png"), std::string::npos);
  for (const render::Scene& scene :
       {render::read_ply(folder / "mesh.ply"), render::read_obj(folder / "mesh.obj")}) {
    ASSERT_EQ(scene.meshes.size(), 1U);
    const render::Mesh& back = scene.meshes[0];
    ASSERT_EQ(back.vertices.size(), mesh.vertices.size());
    ASSERT_EQ(back.triangles.size(), mesh.triangles.size());
    ASSERT_EQ(back.normals.size(), mesh.vertices.size());
    for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(back.vertices[i][static_cast<int>(c)], double{mesh.vertices[i][c]}, 1e-6);
      }
      EXPECT_NEAR(back.normals[i].z(), 1.0, 1e-6);
    }
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        EXPECT_EQ(back.triangles[i][static_cast<int>(c)],
                  static_cast<int>(mesh.triangles[i][c]));
      }
    }
  }
}

TEST(SurfaceMesh, LeavesOutUnknownNaNCutAndSteep) {
  Sheet s = sheet();
  s.known(0, 0) = 0;
  EXPECT_EQ(mesh_of(s).triangles.size(), 47U);
  EXPECT_EQ(mesh_of(s).vertices.size(), 34U);
  s.points(4, 6, 2) = std::numeric_limits<float>::quiet_NaN();
  const render::SurfaceMesh with_hole = mesh_of(s);
  EXPECT_EQ(with_hole.triangles.size(), 46U);
  for (const auto& vertex : with_hole.vertices) {
    EXPECT_TRUE(std::isfinite(vertex[2]));
  }
  s = sheet();
  for (int y = 0; y < 5; ++y) {
    s.cut(y, 2, 0) = 1;  // nothing joins the columns 2 and 3
  }
  EXPECT_EQ(mesh_of(s).triangles.size(), 40U);
  s = sheet();
  for (int y = 0; y < 5; ++y) {
    for (int x = 4; x < 7; ++x) {
      s.points(y, x, 2) += 50.0F;
    }
  }
  SurfaceMeshOptions options;
  options.max_tilt_deg = 85.0;
  EXPECT_EQ(mesh_of(s, options).triangles.size(), 40U);
}

TEST(SurfaceMesh, WithoutTrianglesIsRefused) {
  const TemporaryFolder folder;
  Sheet s = sheet();
  s.known = Image<std::uint8_t>(5, 7, 1);
  s.known(2, 2) = 1;
  const render::SurfaceMesh mesh = mesh_of(s);
  EXPECT_TRUE(mesh.vertices.empty());
  EXPECT_THROW(render::write_ply(mesh, folder / "mesh.ply"), Error);
  EXPECT_THROW(render::write_obj(mesh, folder / "mesh.obj", "x.png"), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "mesh.ply"));
}

}  // namespace
}  // namespace haarlight::relight
