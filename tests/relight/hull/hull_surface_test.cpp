// SPDX-License-Identifier: Apache-2.0
#include "relight/hull/hull_surface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <numbers>
#include <numeric>
#include <sstream>
#include <string>
#include <utility>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/files.h"
#include "haarlight/render/scene/scene.h"
#include "relight/hull/hull_cells.h"
#include "relight/hull/hull_preview.h"
#include "render/cell_mesh/vtu_writer.h"
#include "tests/relight/shadow/shadow_scene.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// Empty, 20 x 15 x 12 voxels of 2 mm from 10 mm over the plane.
ShadowHull empty_hull(double side = 1.0) {
  ShadowHull hull;
  hull.grid = make_voxel_grid(shadow_scene::ground(), side,
                              {{-20.0, -15.0, 10.0}, {20.0, 15.0, 34.0}}, 2.0);
  hull.states.assign(hull.grid.size(), VoxelState::empty);
  return hull;
}

template <class IsIn>
ShadowHull hull_of(const IsIn& is_in, double side = 1.0) {
  ShadowHull hull = empty_hull(side);
  for (int z = 0; z < hull.grid.nz; ++z) {
    for (int y = 0; y < hull.grid.ny; ++y) {
      for (int x = 0; x < hull.grid.nx; ++x) {
        if (is_in(x, y, z)) {
          hull.states[hull.grid.index(x, y, z)] = VoxelState::matter;
        }
      }
    }
  }
  return hull;
}

/// A fifth of the voxels, of every kind, up to the grid's border.
ShadowHull random_hull(double side) {
  ShadowHull hull = empty_hull(side);
  for (std::size_t i = 0; i < hull.states.size(); ++i) {
    if (uniform_unit(hash_key(5, i)) < 0.2) {
      hull.states[i] = static_cast<VoxelState>(1 + hash_key(6, i) % 3);
    }
  }
  return hull;
}

Vector3d vertex(const render::SurfaceMesh& mesh, std::uint32_t i) {
  const auto& [x, y, z] = mesh.vertices[i];
  return {double{x}, double{y}, double{z}};
}

/// By the divergence theorem.
double volume_of(const render::SurfaceMesh& mesh) {
  double volume = 0.0;
  for (const auto& [a, b, c] : mesh.triangles) {
    volume += vertex(mesh, a).dot(vertex(mesh, b).cross(vertex(mesh, c))) / 6.0;
  }
  return volume;
}

double area_of(const render::SurfaceMesh& mesh) {
  double area = 0.0;
  for (const auto& [a, b, c] : mesh.triangles) {
    area += 0.5 *
            (vertex(mesh, b) - vertex(mesh, a)).cross(vertex(mesh, c) - vertex(mesh, a)).norm();
  }
  return area;
}

/// How often the surface winds around a point: its solid angle over 4 pi [VanOosterom83].
double winding(const render::SurfaceMesh& mesh, const Vector3d& point) {
  double angle = 0.0;
  for (const auto& [i, j, k] : mesh.triangles) {
    const Vector3d a = vertex(mesh, i) - point;
    const Vector3d b = vertex(mesh, j) - point;
    const Vector3d c = vertex(mesh, k) - point;
    angle += 2.0 * std::atan2(a.dot(b.cross(c)), a.norm() * b.norm() * c.norm() +
                                                     a.dot(b) * c.norm() + a.dot(c) * b.norm() +
                                                     b.dot(c) * a.norm());
  }
  return angle / (4.0 * std::numbers::pi);
}

void expect_closed(const render::SurfaceMesh& mesh) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> balance;
  for (const auto& [a, b, c] : mesh.triangles) {
    for (const auto& [from, to] : {std::pair(a, b), std::pair(b, c), std::pair(c, a)}) {
      balance[{std::min(from, to), std::max(from, to)}] += from < to ? 1 : -1;
    }
  }
  for (const auto& [edge, sum] : balance) {
    EXPECT_EQ(sum, 0) << edge.first << " " << edge.second;
  }
}

std::int64_t n_full(const ShadowHull& hull) {
  return std::count_if(hull.states.begin(), hull.states.end(), is_taken_as_matter);
}

TEST(HullSurface, UnsmoothedItEnclosesTheVoxelsVolume) {
  for (const double side : {1.0, -1.0}) {
    const ShadowHull hull = random_hull(side);
    const render::SurfaceMesh mesh = hull_surface(hull, {0});
    expect_closed(mesh);
    // Corners are even numbers of mm: floats hold them, sums of doubles round to 1e-12.
    EXPECT_NEAR(volume_of(mesh), 8.0 * static_cast<double>(n_full(hull)), 1e-6) << side;
  }
}

TEST(HullSurface, SmoothedItKeepsEveryCentreOnItsSide) {
  for (const double side : {1.0, -1.0}) {
    const ShadowHull hull = random_hull(side);
    const render::SurfaceMesh mesh = hull_surface(hull);
    expect_closed(mesh);
    for (int z = 0; z < hull.grid.nz; ++z) {
      for (int y = 0; y < hull.grid.ny; ++y) {
        for (int x = (y + z) % 3; x < hull.grid.nx; x += 3) {
          const bool is_full = is_taken_as_matter(hull.states[hull.grid.index(x, y, z)]);
          const double around = winding(mesh, hull.grid.world_of(x + 0.5, y + 0.5, z + 0.5));
          EXPECT_NEAR(around, is_full ? 1.0 : 0.0, 1e-3) << x << " " << y << " " << z;
        }
      }
    }
  }
}

TEST(HullSurface, NoVertexMovesFurtherThanHalfAVoxel) {
  const ShadowHull hull = random_hull(1.0);
  const render::SurfaceMesh sharp = hull_surface(hull, {0});
  const render::SurfaceMesh smooth = hull_surface(hull);
  ASSERT_EQ(sharp.vertices.size(), smooth.vertices.size());
  double furthest = 0.0;
  for (std::uint32_t i = 0; i < sharp.vertices.size(); ++i) {
    furthest =
        std::max(furthest, (vertex(smooth, i) - vertex(sharp, i)).cwiseAbs().maxCoeff() / 2.0);
  }
  EXPECT_LE(furthest, 0.5 + 1e-5);  // floats of some 30 mm
  EXPECT_GT(furthest, 0.2);
}

TEST(HullSurface, OfABallIsRoundAfterSmoothing) {
  constexpr double kRadius = 5.5;  // voxels
  const ShadowHull hull = hull_of(
      [](int x, int y, int z) { return Vector3d(x - 9.5, y - 7.0, z - 5.5).norm() < kRadius; });
  const double true_area = 4.0 * std::numbers::pi * 4.0 * kRadius * kRadius;
  // Voxels' faces show 1.5 times the area of any convex body.
  EXPECT_NEAR(area_of(hull_surface(hull, {0})) / true_area, 1.5, 0.05);
  const render::SurfaceMesh smooth = hull_surface(hull);
  EXPECT_NEAR(area_of(smooth) / true_area, 1.0, 0.05);
  EXPECT_NEAR(volume_of(smooth) / (8.0 * static_cast<double>(n_full(hull))), 1.0, 0.03);
  const Vector3d centre = hull.grid.world_of(10.0, 7.5, 6.0);
  double least_outward = 1.0;
  for (std::uint32_t i = 0; i < smooth.vertices.size(); ++i) {
    const auto& [x, y, z] = smooth.normals[i];
    least_outward =
        std::min(least_outward, Vector3d(double{x}, double{y}, double{z})
                                    .dot((vertex(smooth, i) - centre).normalized()));
  }
  EXPECT_GT(least_outward, 0.8);
}

TEST(HullSurface, OfATwigDoesNotVanish) {
  const ShadowHull hull =
      hull_of([](int x, int y, int z) { return y == 7 && z == 6 && x > 1 && x < 18; });
  const double kept = volume_of(hull_surface(hull)) / (8.0 * static_cast<double>(n_full(hull)));
  EXPECT_GT(kept, 0.2);  // half the width
  EXPECT_LE(kept, 1.0);
}

TEST(HullSurface, IsOrangeWhereMatterIsAssumed) {
  ShadowHull hull = hull_of([](int x, int y, int z) { return x == 3 && y == 3 && z == 3; });
  hull.states[hull.grid.index(12, 10, 8)] = VoxelState::assumed_full;
  hull.states[hull.grid.index(8, 8, 8)] = VoxelState::assumed_empty;
  const render::SurfaceMesh mesh = hull_surface(hull);
  ASSERT_EQ(mesh.vertices.size(), 16U);  // of two voxels
  const auto n_grey = std::count_if(mesh.colours.begin(), mesh.colours.end(),
                                    [](const auto& c) { return c[0] == c[1] && c[1] == c[2]; });
  EXPECT_EQ(n_grey, 8);
}

TEST(HullSurface, OfNothingIsEmpty) {
  EXPECT_TRUE(hull_surface(empty_hull()).triangles.empty());
}

TEST(HullSurface, ComesBackFromPly) {
  const testing::TemporaryFolder folder;
  // Two voxels that meet in a corner: its sides cancel, and its normal has to be one of them.
  const ShadowHull touching = hull_of([](int x, int y, int z) {
    return (x == 4 && y == 4 && z == 4) || (x == 5 && y == 5 && z == 5);
  });
  for (const render::SurfaceMesh& mesh :
       {hull_surface(random_hull(1.0)), hull_surface(touching, {0})}) {
    render::write_ply(mesh, folder / "hull.ply");
    const render::Scene scene = render::read_ply(folder / "hull.ply");
    ASSERT_EQ(scene.meshes.size(), 1U);
    EXPECT_EQ(scene.meshes[0].triangles.size(), mesh.triangles.size());
    EXPECT_EQ(scene.meshes[0].vertices.size(), mesh.vertices.size());
  }
}

/// Some evidence for every voxel that is not empty.
ShadowHull with_evidence(ShadowHull hull) {
  for (std::size_t i = 0; i < hull.states.size(); ++i) {
    if (hull.states[i] != VoxelState::empty) {
      hull.evidence.push_back({static_cast<std::uint8_t>(hash_key(7, i) % 256),
                               static_cast<std::uint8_t>(hash_key(8, i) % 256)});
    }
  }
  return hull;
}

template <class T>
std::vector<T> values_of(const render::HexahedralMesh& mesh, const std::string& name) {
  for (const render::CellValues& cell : mesh.values) {
    if (cell.name == name) {
      return std::get<std::vector<T>>(cell.values);
    }
  }
  ADD_FAILURE() << "no " << name;
  return {};
}

TEST(HullCells, AreTheVoxelsThatAreNotEmpty) {
  for (const double side : {1.0, -1.0}) {
    const ShadowHull hull = with_evidence(random_hull(side));
    const render::HexahedralMesh mesh = hull_cells(hull).mesh;
    ASSERT_EQ(mesh.cells.size(), hull.evidence.size());
    for (const auto& cell : mesh.cells) {
      const auto corner = [&](std::size_t i) {
        const auto& [x, y, z] = mesh.points[static_cast<std::size_t>(cell[i])];
        return Vector3d(double{x}, double{y}, double{z});
      };
      const Vector3d a = corner(1) - corner(0);
      const Vector3d b = corner(3) - corner(0);
      const Vector3d c = corner(4) - corner(0);
      EXPECT_NEAR(a.cross(b).dot(c), 8.0, 1e-6);  // right-handed, of the voxel's size
      EXPECT_NEAR((corner(6) - corner(0) - a - b - c).norm(), 0.0, 1e-6);
      EXPECT_NEAR((corner(2) - corner(0) - a - b).norm(), 0.0, 1e-6);
    }
    const auto opacity = values_of<std::uint8_t>(mesh, "opacity");
    EXPECT_EQ(std::count(opacity.begin(), opacity.end(), 1), n_full(hull));
    const auto lit = values_of<float>(mesh, "lit_evidence");
    const auto seen = values_of<float>(mesh, "seen_fraction");
    EXPECT_FLOAT_EQ(lit[5], static_cast<float>(hull.evidence[5].lit) / 255.0F);
    EXPECT_FLOAT_EQ(seen[5], static_cast<float>(hull.evidence[5].seen) / 255.0F);
  }
}

TEST(HullCells, StateBetweenWhichHeightsTheObjectIs) {
  ShadowHull hull = hull_of(
      [](int x, int y, int z) { return x == 4 && y == 4 && ((z >= 2 && z < 5) || z == 11); });
  hull.states[hull.grid.index(4, 4, 5)] = VoxelState::assumed_empty;
  const HullCells cells = hull_cells(with_evidence(hull));
  const auto low = values_of<float>(cells.mesh, "height_low_mm");
  const auto high = values_of<float>(cells.mesh, "height_high_mm");
  ASSERT_EQ(low.size(), 5U);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_FLOAT_EQ(low[i], 14.0F);
    EXPECT_FLOAT_EQ(high[i], 22.0F);
  }
  EXPECT_FLOAT_EQ(low[4], 32.0F);
  EXPECT_FLOAT_EQ(high[4], 34.0F);
  EXPECT_NEAR(cells.median_height_range_mm, 8.0, 1e-12);
}

TEST(HullCells, AreWrittenAsTheHeaderSays) {
  const testing::TemporaryFolder folder;
  const render::HexahedralMesh mesh = hull_cells(with_evidence(random_hull(1.0))).mesh;
  render::write_vtu(mesh, folder / "hull.vtu");
  const std::string text = read_file(folder / "hull.vtu");
  const std::size_t start = text.find("\n_") + 2;
  // Each array lies where its description says, its size before it, up to the next one.
  const std::size_t n = mesh.cells.size();
  const std::vector<std::pair<std::string, std::size_t>> expected{
      {"Points", 12 * mesh.points.size()},
      {"connectivity", 32 * n},
      {"offsets", 8 * n},
      {"types", n},
      {"state", n},
      {"opacity", n},
      {"lit_evidence", 4 * n},
      {"seen_fraction", 4 * n},
      {"height_low_mm", 4 * n},
      {"height_high_mm", 4 * n}};
  std::size_t at = start;
  for (const auto& [name, size] : expected) {
    const std::size_t array = text.find("Name=\"" + name + "\"");
    ASSERT_LT(array, start) << name;
    const std::size_t offset = text.find("offset=\"", array) + 8;
    EXPECT_EQ(start + std::stoul(text.substr(offset)), at) << name;
    std::uint64_t bytes = 0;
    text.copy(reinterpret_cast<char*>(&bytes), sizeof bytes, at);
    EXPECT_EQ(bytes, size) << name;
    at += sizeof bytes + size;
  }
  EXPECT_EQ(text.substr(at), "\n</AppendedData>\n</VTKFile>\n");
  float x = 0.0F;
  text.copy(reinterpret_cast<char*>(&x), sizeof x, start + sizeof(std::uint64_t));
  EXPECT_EQ(x, mesh.points[0][0]);
}

TEST(HullCells, AreReadByMeshio) {
  if (std::system("/usr/bin/python3 -c 'import meshio' 2>/dev/null") != 0) {
    GTEST_SKIP() << "needs /usr/bin/python3 with meshio (Debian: python3-meshio)";
  }
  const testing::TemporaryFolder folder;
  const ShadowHull hull = with_evidence(random_hull(-1.0));
  const render::HexahedralMesh mesh = hull_cells(hull).mesh;
  render::write_vtu(mesh, folder / "hull.vtu");
  render::write_ply(hull_surface(hull, {0}), folder / "hull.ply");
  const std::string script = HAARLIGHT_SOURCE_DIR "/tests/relight/hull/read_with_meshio.py";
  const std::string command =
      fmt::format("/usr/bin/python3 {} {} {} > {}", script, (folder / "hull.vtu").string(),
                  (folder / "hull.ply").string(), (folder / "read.txt").string());
  ASSERT_EQ(std::system(command.c_str()), 0);
  std::istringstream read(read_file(folder / "read.txt"));
  std::size_t n = 0;
  double least = 0.0;
  double most = 0.0;
  read >> n >> least >> most;
  EXPECT_EQ(n, mesh.cells.size());
  EXPECT_NEAR(least, 8.0, 1e-6);
  EXPECT_NEAR(most, 8.0, 1e-6);
  for (const render::CellValues& cell : mesh.values) {
    std::string name;
    double sum = 0.0;
    read >> name >> sum;
    EXPECT_EQ(name, cell.name);
    const double expected = std::visit(
        [](const auto& values) { return std::accumulate(values.begin(), values.end(), 0.0); },
        cell.values);
    EXPECT_NEAR(sum, expected, 1e-9 * expected) << name;
  }
  std::string word;
  double volume = 0.0;
  read >> word >> volume;
  EXPECT_NEAR(volume, 8.0 * static_cast<double>(n_full(hull)), 1e-3);
}

TEST(HullPreview, ShowsTheHullInEveryView) {
  const ShadowHull hull = hull_of(
      [](int x, int y, int z) { return x > 5 && x < 14 && y > 3 && y < 11 && z > 2 && z < 9; });
  const render::SurfaceMesh surface = hull_surface(hull);
  CameraModel camera;
  camera.width = 96;
  camera.height = 96;
  camera.fx = camera.fy = 900.0;
  camera.cx = camera.cy = 48.0;
  const Vector3d centre = hull.grid.world_of(10.0, 7.5, 6.0);
  camera.world_from_cam =
      look_at(centre + Vector3d(0.0, -300.0, 500.0), centre, Vector3d::UnitZ());
  const Image<float> picture = hull_preview(hull, surface, camera, shadow_scene::ground());
  ASSERT_EQ(picture.width(), 960);
  ASSERT_EQ(picture.height(), 720);
  for (const auto& [y, x] :
       {std::pair(180, 240), std::pair(180, 720), std::pair(540, 240), std::pair(540, 720)}) {
    // Grey of the hull under at most pi of irradiance; the floor is twice as bright.
    EXPECT_GT(picture(y, x, 0), 0.05F) << y << " " << x;
    EXPECT_LT(picture(y, x, 0), 0.46F) << y << " " << x;
    EXPECT_FLOAT_EQ(picture(y, x, 0), picture(y, x, 2));
  }
}

TEST(HullPreview, TurnsTheHullBeforeTheEye) {
  // Long in x, narrow in y, with a post at its end of low x.
  const ShadowHull hull = hull_of([](int x, int y, int z) {
    return y > 6 && y < 10 && z > 2 &&
           ((x > 3 && x < 16 && z < 6) || (x > 3 && x < 7 && z < 10));
  });
  render::SurfaceMesh surface = hull_surface(hull);
  std::fill(surface.colours.begin(), surface.colours.end(),
            std::array<std::uint8_t, 3>{255, 0, 0});
  const Image<float> picture = hull_turning(hull, surface, shadow_scene::ground(), 4);
  ASSERT_EQ(picture.width(), 480);
  ASSERT_EQ(picture.height(), 4 * 360);
  std::array<int, 4> width{};
  std::array<double, 4> post{};  // where its top is seen
  for (int i = 0; i < 4; ++i) {
    int low = 480;
    int high = 0;
    for (int y = 359; y >= 0; --y) {
      for (int x = 0; x < 480; ++x) {
        if (picture(360 * i + y, x, 0) > 4.0F * picture(360 * i + y, x, 2)) {
          low = std::min(low, x);
          high = std::max(high, x);
          post.at(static_cast<std::size_t>(i)) = x - 240;
        }
      }
    }
    width.at(static_cast<std::size_t>(i)) = high - low;
  }
  EXPECT_GT(width[0], 2 * width[1]);
  EXPECT_NEAR(width[0], width[2], 5);
  EXPECT_NEAR(width[1], width[3], 5);
  EXPECT_LT(post[0], -12.0) << "from the front, low x is on the left";
  EXPECT_GT(post[2], 12.0) << "from behind it is on the right";
}

}  // namespace
}  // namespace haarlight::relight
