// SPDX-License-Identifier: Apache-2.0
/// @file
/// Quadratic tetrahedra with bent edges: a linear field is linear whatever bends within the cube; what
/// rays see of a ball of bent cells is its volume; faces one by one against an elimination.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/volume/bent_face.h"
#include "render/volume/cell_faces.h"
#include "render/volume/volume_ray_caster.h"
#include "render/volume/volume_view.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr double kExact = 1e-12;

/// The cube in n^3 times six quadratic tetrahedra. The middles of edges are moved by up to a part of the
/// edge, those on the cube's surface within it.
CellMesh bent_cube(std::size_t n, double part, unsigned seed = 1) {
  CellMesh mesh = test::cube_of(CellType::quadratic_tetrahedron, n);
  std::vector<bool> is_middle(mesh.points.size());
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    for (const std::uint32_t node : mesh.nodes_of(i).subspan(4)) {
      is_middle[node] = true;
    }
  }
  std::mt19937 random(seed);
  const double most = part / static_cast<double>(n);
  std::uniform_real_distribution<double> move(-most, most);
  for (std::size_t i = 0; i < mesh.points.size(); ++i) {
    for (double& x : mesh.points[i]) {
      const double moved = x + move(random);
      x = is_middle[i] && x > 0.0 && x < 1.0 ? moved : x;
    }
  }
  return mesh;
}

struct Rendered {
  std::vector<VolumeLight> pixels;
  VolumeCounts counts;
};
Rendered rendered(const VolumeScene& scene) {
  const VolumeRayCaster caster(scene, {});
  Rendered made{.pixels = test::picture_by(caster, scene), .counts = caster.counts()};
  caster.require_no_overlap();
  return made;
}

TEST(BentCells, ALinearFieldIsExactWhateverBends) {
  for (const double part : {1e-9, 1e-4, 0.05, 0.1}) {
    for (const std::size_t n : {1U, 3U}) {
      VolumeScene scene = test::scene_of(bent_cube(n, part));
      for (const double pixel_mm : {0.0, 2.0 / 33.0}) {
        test::look_at_cube({1.9, 2.2, 3.1}, 33, scene);
        scene.optics.pixel_mm = pixel_mm;
        const Rendered made = rendered(scene);
        const double error = test::error_of_cube(scene, made.pixels);
        std::printf("bent by %g, %zu: largest error %.2g\n", part, n, error);
        EXPECT_LE(error, kExact) << part << ' ' << n;
        EXPECT_EQ(made.counts.undecided_rays, 0U);
        EXPECT_EQ(made.counts.lost_points, 0U);
      }
    }
  }
}

/// From the eye at nodes, along edges, and along axes through nodes.
TEST(BentCells, RaysThroughNodesAreMovedAndNoCellIsLost) {
  VolumeScene scene = test::scene_of(bent_cube(2, 0.05));
  scene.camera.width = scene.camera.height = 9;
  scene.camera.cx = scene.camera.cy = 4.5;
  scene.camera.fx = scene.camera.fy = 4.0;
  for (const Vector3d& eye : {Vector3d(0.5, 0.5, 0.5), Vector3d(0.5, 0.5, -1.0),
                              Vector3d(0.0, 0.0, 0.0), Vector3d(0.5, 0.5, 0.0)}) {
    scene.camera.world_from_cam = Eigen::Isometry3d::Identity();
    scene.camera.world_from_cam.translation() = eye;
    const Rendered made = rendered(scene);
    EXPECT_GT(made.counts.moved_rays, 0U);
    EXPECT_EQ(made.counts.undecided_rays, 0U);
    for (int y = 0; y < 9; ++y) {
      for (int x = 0; x < 9; ++x) {
        const auto [origin, direction] = test::pixel_ray(scene, x, y);
        const bool is_in_side =  // of the cube: either picture is right
            (direction.array() == 0.0 && (origin.array() == 0.0 || origin.array() == 1.0))
                .any();
        if (!is_in_side) {
          const VolumeLight truth = test::light_within_cube(scene, origin, direction);
          const VolumeLight& light = test::pixel_of(made.pixels, scene, x, y);
          // Moved by 1e-14, doubled a few times; light changes by ten in a unit of length.
          EXPECT_LE((light.light - truth.light).abs().maxCoeff(), kExact)
              << eye.transpose() << ' ' << x << ' ' << y;
        }
      }
    }
  }
}

TEST(BentCells, TheOrderOfCellsChangesNothing) {
  VolumeScene scene = test::scene_of(bent_cube(2, 0.1));
  test::look_at_cube({1.9, 2.2, 3.1}, 33, scene);
  const std::vector<VolumeLight> picture = rendered(scene).pixels;
  std::vector<std::size_t> order(scene.mesh.n_cells());
  for (std::size_t i = 0; i < order.size(); ++i) {
    order[i] = order.size() - 1 - i;
  }
  scene.mesh = test::chosen(scene.mesh, order);
  EXPECT_EQ(test::difference(picture, rendered(scene).pixels), 0.0);
}

/// Thin fog of constant density glows by 1 per length: the sum over a parallel picture's pixels is the
/// volume of the bent mesh, to the rule of the pixels' middles.
TEST(BentCells, ARoundedCubeIsAsLargeAsItsNodesSay) {
  CellMesh mesh = test::cube_of(CellType::quadratic_tetrahedron, 2);
  const Vector3d middle = Vector3d::Constant(0.5);
  for (Vector3d& point : mesh.points) {  // shells of cubes, towards shells of balls
    const Vector3d off = point - middle;
    const double size = off.cwiseAbs().maxCoeff();
    point = size > 0.0 ? Vector3d(middle + (0.4 * size / off.norm() + 0.6) * off) : point;
  }
  double volume = 0.0;
  for (std::size_t i = 0; i < mesh.n_cells(); ++i) {
    ASSERT_EQ(folding_of(mesh, i), Folding::none) << i;
    volume += cell_volume(mesh, i);
  }
  VolumeScene scene = test::scene_of(std::move(mesh));
  scene.glow = Glow::own;
  scene.density = PiecewiseLinear<double>({0.0}, {0.0});
  scene.colour = PiecewiseLinear<Eigen::Array3d>({0.0}, {Eigen::Array3d::Ones()});
  constexpr int kSide = 300;
  test::look_at_cube({1.9, 2.2, 3.1}, kSide, scene);
  scene.optics.pixel_mm = 1.6 / kSide;
  const Rendered made = rendered(scene);
  double sum = 0.0;
  for (const VolumeLight& light : made.pixels) {
    sum += light.light[0];
  }
  sum *= scene.optics.pixel_mm * scene.optics.pixel_mm;
  std::printf("volume %.9g, by rays %.9g\n", volume, sum);
  // At the outline rays lengthen as a root: middles are off by the 3/2 power of pixels, in a random position.
  EXPECT_NEAR(sum, volume, 2e-7);
  EXPECT_EQ(made.counts.undecided_rays, 0U);
}

TEST(BentCells, ProjectionRefusesThemAndNamesTheCure) {
  const VolumeScene scene = test::scene_of(bent_cube(1, 0.05));
  try {
    static_cast<void>(test::project(scene));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("cell 0 is a quadratic tetrahedron with a bent edge"),
              std::string::npos)
        << error.what();
    EXPECT_NE(std::string(error.what()).find("--algorithm ray-casting"), std::string::npos)
        << error.what();
  }
}

/// One cell bends the diagonal of the cube, of which the others know nothing.
TEST(BentCells, AFaceThatTwoCellsBendOtherwiseIsABorderOfEach) {
  VolumeScene scene = test::scene_of(test::cube_of(CellType::quadratic_tetrahedron, 1));
  CellMesh& mesh = scene.mesh;
  const std::size_t n_before = connect_cells(mesh, "cube.vtu").boundary.size();
  const auto begin = mesh.nodes.begin();
  const auto middle = std::find_if(begin, begin + 10, [&](std::uint32_t node) {
    return mesh.points[node] == Vector3d::Constant(0.5);
  });
  ASSERT_NE(middle, begin + 10);
  *middle = static_cast<std::uint32_t>(mesh.points.size());
  mesh.points.emplace_back(0.55, 0.5, 0.5);
  EXPECT_EQ(connect_cells(mesh, "cube.vtu").boundary.size(), n_before + 4);
  scene.density_field = scene.colour_field = test::linear_field(mesh);
  test::look_at_cube({1.9, 2.2, 3.1}, 33, scene);
  EXPECT_NO_THROW(static_cast<void>(rendered(scene)));  // a gap: the cell has shrunk
  mesh.points.back().x() = 0.45;
  EXPECT_THROW(static_cast<void>(rendered(scene)), Error);  // they overlap
}

/// The patch as another cell may give it: begun at corner `first`, and the other way round.
PatchNodes given_otherwise(const PatchNodes& patch, std::size_t first, bool is_reversed) {
  const std::size_t n = patch.n_corners();
  const std::size_t on_edge = patch.form == PatchForm::cubic_triangle ? 2 : 1;
  PatchNodes made = patch;  // with the node in the middle, if any
  for (std::size_t i = 0; i < n; ++i) {
    const auto corner = [&](std::size_t k) {
      return is_reversed ? (first + n - k % n) % n : (first + k) % n;
    };
    made.nodes.at(i) = patch.nodes.at(corner(i));
    const std::size_t edge = is_reversed ? corner(i + 1) : corner(i);
    for (std::size_t k = 0; k < on_edge; ++k) {
      made.nodes.at(n + on_edge * i + k) =
          patch.nodes.at(n + on_edge * edge + (is_reversed ? on_edge - 1 - k : k));
    }
  }
  return made;
}

TEST(BentFaces, ArePatchesOfTheSameNodesFromEitherCell) {
  std::mt19937 random(7);
  for (const auto& [form, n] : {std::pair(PatchForm::quadratic_triangle, std::size_t{6}),
                                {PatchForm::cubic_triangle, 10},
                                {PatchForm::serendipity, 8},
                                {PatchForm::biquadratic, 9}}) {
    for (int trial = 0; trial < 50; ++trial) {
      PatchNodes patch{.form = form, .n = n};
      std::iota(patch.nodes.begin(), patch.nodes.begin() + static_cast<std::ptrdiff_t>(n), 20U);
      std::shuffle(patch.nodes.begin(), patch.nodes.begin() + static_cast<std::ptrdiff_t>(n),
                   random);
      const SortedPatch once = sorted(patch);
      for (std::size_t first = 0; first < patch.n_corners(); ++first) {
        for (const bool is_reversed : {false, true}) {
          const PatchNodes other = given_otherwise(patch, first, is_reversed);
          const SortedPatch again = sorted(other);
          EXPECT_EQ(again.patch.nodes, once.patch.nodes);
          EXPECT_EQ(again.is_turned, once.is_turned != is_reversed);
          for (std::size_t i = 0; i < patch.n_corners(); ++i) {
            EXPECT_EQ(other.nodes.at(again.order.at(i)), again.patch.nodes.at(i));
          }
        }
      }
    }
  }
}

/// A wide patch over the square: parallel rays along z pass it once, at a height that is known.
TEST(BentFaces, HeightsOfAPatchAreThoseOfItsPolynomial) {
  CellMesh mesh = test::cube_of(CellType::quadratic_tetrahedron, 1);
  VolumeScene scene = test::scene_of(mesh);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> number(-0.1, 0.1);
  scene.optics.pixel_mm = 1.0;
  scene.camera.world_from_cam = Eigen::Isometry3d::Identity();
  int n_found = 0;
  for (int trial = 0; trial < 200; ++trial) {
    const PatchNodes patch{
        .form = PatchForm::quadratic_triangle, .n = 6, .nodes = {0, 1, 2, 3, 4, 5}};
    const std::array<Vector3d, 6> flat = {Vector3d(0, 0, 0),     Vector3d(1, 0, 0),
                                          Vector3d(0, 1, 0),     Vector3d(0.5, 0, 0),
                                          Vector3d(0.5, 0.5, 0), Vector3d(0, 0.5, 0)};
    for (std::size_t i = 0; i < flat.size(); ++i) {
      scene.mesh.points[i] =
          flat.at(i) + Vector3d(number(random), number(random), number(random));
    }
    const VolumeView view(scene, FaceForm::general);
    // A point of the patch by its shape functions, and the ray through it.
    const double u = 0.3 + number(random);
    const double v = 0.3 + number(random);
    const double w = 1.0 - u - v;
    const std::array<double, 6> weights = {w * (2.0 * w - 1.0), u * (2.0 * u - 1.0),
                                           v * (2.0 * v - 1.0), 4.0 * w * u,
                                           4.0 * u * v,         4.0 * v * w};
    Vector3d at = Vector3d::Zero();
    for (std::size_t i = 0; i < weights.size(); ++i) {
      at += weights.at(i) * scene.mesh.points[i];
    }
    std::vector<BentCrossing> crossings;
    ASSERT_TRUE(add_bent_crossings(view, at.head<2>(), Vector2d::Zero(), patch, crossings));
    const auto is_it = [&](const BentCrossing& crossing) {
      return std::abs(crossing.z - at.z()) < 1e-13 && crossing.is_left_by;
    };
    EXPECT_EQ(std::ranges::count_if(crossings, is_it), 1) << trial;
    n_found += static_cast<int>(crossings.size());
  }
  EXPECT_EQ(n_found, 200);
}

}  // namespace
}  // namespace haarlight::render
