// SPDX-License-Identifier: Apache-2.0
/// @file
/// Pictures of tetrahedra against the cube's closed form: golden rays of 40 digits, whole pictures, and
/// the views in which rays run along edges, in faces and through vertices.

#include "render/volume/volume_ray_caster.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "render/volume/side_of_ray.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using test::Split;
using test::Transfer;
using test::VolumeLight;

constexpr double kExact = 1e-12;

std::vector<CellMesh> cubes() {
  return {test::cube_of_tetrahedra(1, Split::six), test::cube_of_tetrahedra(1, Split::five),
          test::cube_of_tetrahedra(4, Split::six), test::cube_of_tetrahedra(3, Split::five)};
}

TEST(VolumeRayCaster, GoldenRaysThroughTheCube) {
  int n_checked = 0;
  double worst = 0.0;
  for (const test::GoldenRay& ray : test::golden_rays("linear")) {
    for (CellMesh& mesh : cubes()) {
      VolumeScene scene = test::scene_of(std::move(mesh));
      worst = std::max(worst, test::relative_error(ray, scene));
      ++n_checked;
    }
  }
  std::printf("%d rays, largest relative error %.2g\n", n_checked, worst);
  EXPECT_LE(worst, kExact);
  EXPECT_GE(n_checked, 4 * 5);
}

TEST(VolumeRayCaster, WholePicturesOfTheCube) {
  double worst = 0.0;
  for (CellMesh& mesh : cubes()) {
    VolumeScene scene = test::scene_of(std::move(mesh));
    for (const Transfer transfer :
         {Transfer::hills, Transfer::spikes, Transfer::nearly_constant}) {
      test::set_transfer(transfer, scene);
      for (const int side : {32, 37}) {
        test::look_at_cube({1.9, 2.2, 3.1}, side, scene);
        scene.optics.pixel_mm = 0.0;
        worst = std::max(worst, test::error_of_cube(scene, test::render(scene)));
        scene.optics.pixel_mm = 2.0 / side;
        worst = std::max(worst, test::error_of_cube(scene, test::render(scene)));
      }
    }
  }
  std::printf("largest error %.2g\n", worst);
  EXPECT_LE(worst, kExact);
}

/// Rays of a parallel view along an axis, every one of which passes vertices, edges or faces of the
/// mesh: of 9 x 9 pixels from one side of the cube to the other those of one row and one column
/// graze it.
TEST(VolumeRayCaster, AlongEdgesAndThroughVerticesNoCellIsLostOrDoubled) {
  constexpr int kSide = 9;
  const std::array<Vector3d, 3> axes = {Vector3d::UnitX(), Vector3d::UnitY(),
                                        Vector3d::UnitZ()};
  for (CellMesh& mesh : cubes()) {
    VolumeScene scene = test::scene_of(std::move(mesh));
    scene.camera.width = scene.camera.height = kSide;
    scene.camera.cx = scene.camera.cy = 0.5;
    scene.optics.pixel_mm = 0.125;
    for (int axis = 0; axis < 6; ++axis) {
      const Vector3d forward =
          (axis < 3 ? 1.0 : -1.0) * axes.at(static_cast<std::size_t>(axis % 3));
      const Vector3d& right = axes.at(static_cast<std::size_t>((axis + 1) % 3));
      Eigen::Matrix3d turn;
      turn << right, forward.cross(right), forward;
      scene.camera.world_from_cam.linear() = turn;
      // Its corner at the cube's, from which the pixels go right and down.
      Vector3d corner = Vector3d::Zero();
      for (const Vector3d& side : {right, Vector3d(forward.cross(right)), forward}) {
        corner += (side.minCoeff() < 0.0 ? 1.0 : 0.0) * side.cwiseAbs();
      }
      scene.camera.world_from_cam.translation() = corner - 2.0 * forward;
      const std::vector<VolumeLight> picture = test::render(scene);
      int n_seen = 0;
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          const VolumeLight& light = test::pixel_of(picture, scene, x, y);
          n_seen += light.opacity > 0.0 ? 1 : 0;
          if (x > 0 && x < kSide - 1 && y > 0 && y < kSide - 1) {
            const auto [origin, direction] = test::pixel_ray(scene, x, y);
            const VolumeLight truth = test::light_within_cube(scene, origin, direction);
            EXPECT_LE((light.light - truth.light).abs().maxCoeff(), kExact) << x << ' ' << y;
            EXPECT_NEAR(light.opacity, truth.opacity, kExact) << x << ' ' << y;
          }
        }
      }
      EXPECT_EQ(n_seen,
                (kSide - 1) * (kSide - 1));  // half-open: one border of two opposite ones
    }
  }
}

TEST(VolumeRayCaster, TheEyeMayBeWithinACellOnAFaceOrAtAVertex) {
  const std::array<Vector3d, 7> eyes = {Vector3d(0.41, 0.53, 0.37), Vector3d(0.5, 0.5, 0.5),
                                        Vector3d(0.5, 0.25, 0.1),   Vector3d(0.5, 0.3, 0.3),
                                        Vector3d(0.25, 0.3, 0.45),  Vector3d(0.0, 0.0, 0.0),
                                        Vector3d(1.0, 0.5, 0.5)};
  double worst = 0.0;
  for (CellMesh& mesh : cubes()) {
    VolumeScene scene = test::scene_of(std::move(mesh));
    scene.camera.width = scene.camera.height = 16;
    scene.camera.cx = scene.camera.cy = 8.5;  // one pixel looks along the axis itself
    scene.camera.fx = scene.camera.fy = 9.0;
    for (const Vector3d& eye : eyes) {
      // A direction that keeps the rays from running within the cube's own faces.
      scene.camera.world_from_cam =
          look_at(eye, Vector3d(0.31, 0.57, 0.63), Vector3d(0.1, 0.2, 1.0));
      worst = std::max(worst, test::error_of_cube(scene, test::render(scene)));
      scene.camera.world_from_cam =
          look_at(eye, eye + Vector3d(-0.9, 0.4, 0.7), Vector3d(0.1, 0.2, 1.0));
      worst = std::max(worst, test::error_of_cube(scene, test::render(scene)));
    }
  }
  std::printf("largest error %.2g\n", worst);
  EXPECT_LE(worst, kExact);
}

TEST(VolumeRayCaster, ClipsAtNearAndFar) {
  for (const double pixel_mm : {0.0, 0.05}) {
    VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
    test::look_at_cube({1.9, 2.2, 3.1}, 32, scene);
    scene.optics.pixel_mm = pixel_mm;
    for (const std::array<double, 2> clip :
         {std::array{3.2, 0.0}, {0.0, 3.4}, {3.1, 3.15}, {9.0, 10.0}}) {
      scene.optics.near_mm = clip[0];
      scene.optics.far_mm = clip[1];
      EXPECT_LE(test::error_of_cube(scene, test::render(scene)), kExact);
    }
  }
}

TEST(VolumeRayCaster, ShuffledCellsGiveTheSameBits) {
  const CellMesh mesh = test::cube_of_tetrahedra(4);
  VolumeScene scene = test::scene_of(mesh);
  test::look_at_cube({1.9, 2.2, 3.1}, 48, scene);
  const std::vector<VolumeLight> picture = test::render(scene);
  std::vector<std::size_t> order(mesh.n_cells());
  std::iota(order.begin(), order.end(), 0U);
  std::ranges::shuffle(order, std::mt19937(7));
  for (std::size_t i = 0; i < order.size(); ++i) {
    const std::span<const std::uint32_t> nodes = mesh.nodes_of(order[i]);
    std::ranges::copy(nodes, scene.mesh.nodes.begin() + static_cast<std::ptrdiff_t>(4 * i));
  }
  const std::vector<VolumeLight> shuffled = test::render(scene);
  for (std::size_t i = 0; i < picture.size(); ++i) {
    ASSERT_TRUE((picture[i].light == shuffled[i].light).all());
    ASSERT_EQ(picture[i].opacity, shuffled[i].opacity);
  }
}

TEST(VolumeRayCaster, MeshAndCameraTurnedTogetherGiveTheSamePicture) {
  const CellMesh mesh = test::cube_of_tetrahedra(4);
  VolumeScene scene = test::scene_of(mesh);
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  const std::vector<VolumeLight> picture = test::render(scene);
  const Eigen::Isometry3d turn = Eigen::Translation3d(5.0, -3.0, 11.0) *
                                 Eigen::AngleAxisd(0.7, Vector3d(1.0, -2.0, 0.5).normalized());
  for (Vector3d& point : scene.mesh.points) {
    point = turn * point;
  }
  scene.camera.world_from_cam = turn * scene.camera.world_from_cam;
  const double worst = test::difference(picture, test::render(scene));
  std::printf("largest difference %.2g\n", worst);
  EXPECT_LE(worst, 1e-11);
}

/// The mesh once more, moved.
void append(CellMesh& mesh, const CellMesh& other, const Vector3d& by) {
  const auto first = static_cast<std::uint32_t>(mesh.points.size());
  for (const Vector3d& point : other.points) {
    mesh.points.emplace_back(point + by);
  }
  for (std::size_t i = 0; i < other.n_cells(); ++i) {
    mesh.types.push_back(other.types[i]);
    mesh.begins.push_back(mesh.nodes.size());
    for (const std::uint32_t node : other.nodes_of(i)) {
      mesh.nodes.push_back(first + node);
    }
  }
}

/// Two cubes with a gap between them, or side by side with faces that only meet in part.
TEST(VolumeRayCaster, EntersEveryPartThatARayMeets) {
  for (const double gap : {0.5, 0.0}) {
    VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
    append(scene.mesh, test::cube_of_tetrahedra(3), Vector3d(0.0, 0.0, 1.0 + gap));
    scene.density_field = scene.colour_field = test::linear_field(test::cube_of_tetrahedra(2));
    const ScalarField above = test::linear_field(test::cube_of_tetrahedra(3));
    for (ScalarField* field : {&scene.density_field, &scene.colour_field}) {
      field->values.insert(field->values.end(), above.values.begin(), above.values.end());
    }
    test::look_at_cube({0.3, 0.4, 6.0}, 32, scene);
    const std::vector<VolumeLight> picture = test::render(scene);
    double worst = 0.0;
    int n_both = 0;
    for (int y = 0; y < 32; ++y) {
      for (int x = 0; x < 32; ++x) {
        const auto [origin, direction] = test::pixel_ray(scene, x, y);
        const VolumeLight front =
            test::light_within_cube(scene, origin - Vector3d(0.0, 0.0, 1.0 + gap), direction);
        const VolumeLight behind = test::light_within_cube(scene, origin, direction);
        const double rest = 1.0 - front.opacity;
        const VolumeLight& light = test::pixel_of(picture, scene, x, y);
        worst =
            std::max({worst, (light.light - front.light - rest * behind.light).abs().maxCoeff(),
                      std::abs(light.opacity - front.opacity - rest * behind.opacity)});
        n_both += front.opacity > 0.0 && behind.opacity > 0.0 ? 1 : 0;
      }
    }
    EXPECT_LE(worst, kExact);
    EXPECT_GT(n_both, 20);
  }
}

TEST(VolumeRayCaster, RefusesCellsThatOverlap) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(1));
  append(scene.mesh, test::cube_of_tetrahedra(1), Vector3d(0.25, 0.0, 0.0));
  scene.density_field = scene.colour_field = test::linear_field(scene.mesh);
  test::look_at_cube({1.9, 2.2, 3.1}, 16, scene);
  try {
    static_cast<void>(test::render(scene));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("overlap"), std::string::npos) << error.what();
    EXPECT_EQ(error.where(), "cube.vtu");
  }
}

TEST(VolumeRayCaster, RefusesAFaceOfThreeCells) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(1));
  for (std::size_t i = 0; i < 4; ++i) {
    scene.mesh.nodes.push_back(scene.mesh.nodes[i]);
  }
  scene.mesh.types.push_back(CellType::tetrahedron);
  scene.mesh.begins.push_back(scene.mesh.nodes.size() - 4);
  try {
    static_cast<void>(test::render(scene));
    FAIL() << "no error";
  } catch (const Error& error) {
    EXPECT_NE(error.problem().find("share a face"), std::string::npos) << error.what();
  }
}

TEST(VolumeRayCaster, AFieldPerCellIsConstantWithinIt) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  scene.density_field = {.name = "one",
                         .is_per_cell = true,
                         .values = std::vector<double>(scene.mesh.n_cells(), 0.5)};
  scene.colour_field = scene.density_field;
  scene.density = {{0.0, 1.0}, {1.0, 2.0}};
  scene.colour = {{0.5}, {Array3d(1.0, 0.5, 0.25)}};
  test::look_at_cube({1.9, 2.2, 3.1}, 32, scene);
  const std::vector<VolumeLight> picture = test::render(scene);
  scene.density = {{0.0}, {1.5}};  // what 0.5 is, everywhere
  EXPECT_LE(test::error_of_cube(scene, picture), kExact);
}

TEST(VolumeRayCaster, WhatRaysLeaveOutIsWithinTheErrorRequested) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(4));
  for (const Glow glow : {Glow::chromaticity, Glow::own}) {
    scene.glow = glow;
    scene.density = {{0.0, 1.0}, {50.0, 20.0}};
    scene.background.colour = {0.5, 0.2, 0.7};
    test::look_at_cube({1.9, 2.2, 3.1}, 32, scene);
    const std::vector<VolumeLight> exact = test::render(scene);
    for (const double max_error : {1e-2, 1e-5}) {
      const std::vector<VolumeLight> ended = test::render(scene, {.max_error = max_error});
      double worst = 0.0;
      for (std::size_t i = 0; i < exact.size(); ++i) {
        worst = std::max(worst, (exact[i].light - ended[i].light).abs().maxCoeff());
      }
      EXPECT_LE(worst, max_error);
      EXPECT_GT(worst, 0.0);  // rays did end
    }
  }
}

/// The sign by whole numbers, which hold it.
int side_of_integers(const std::array<std::int64_t, 2>& p, const std::array<std::int64_t, 3>& a,
                     const std::array<std::int64_t, 3>& b) {
  const std::int64_t det = p[0] * (a[1] * b[2] - a[2] * b[1]) +
                           p[1] * (a[2] * b[0] - a[0] * b[2]) + (a[0] * b[1] - a[1] * b[0]);
  return det > 0 ? 1 : (det < 0 ? -1 : 0);
}

TEST(SideOfRay, IsThatOfWholeNumbersAndNeverZero) {
  std::mt19937 random(3);
  const auto draw = [&random] { return static_cast<std::int64_t>(random() % 7U) - 3; };
  int n_zero = 0;
  for (int i = 0; i < 20000; ++i) {
    const std::array<std::int64_t, 2> p = {draw(), draw()};
    const std::array<std::int64_t, 3> a = {draw(), draw(), draw()};
    const std::array<std::int64_t, 3> b = {draw(), draw(), draw()};
    if (a == b) {
      continue;
    }
    const auto seen = [](const std::array<std::int64_t, 3>& at) {
      return SeenPoint{.x = static_cast<double>(at[0]),
                       .y = static_cast<double>(at[1]),
                       .z = static_cast<double>(at[2])};
    };
    const Vector2d ray(static_cast<double>(p[0]), static_cast<double>(p[1]));
    for (const Projection projection : {Projection::perspective, Projection::parallel}) {
      const int side = exact_side(projection, ray, seen(a), seen(b));
      EXPECT_TRUE(side == 1 || side == -1);
      EXPECT_EQ(exact_side(projection, ray, seen(b), seen(a)), -side);
      if (projection == Projection::perspective) {
        const int truth = side_of_integers(p, a, b);
        n_zero += truth == 0 ? 1 : 0;
        EXPECT_TRUE(truth == 0 || truth == side);
      }
    }
  }
  EXPECT_GT(n_zero, 500);
}

/// Edges that miss the ray by a millionth of a millionth of its distance from the axis: products of
/// their coordinates alone are off by far more than that.
TEST(SideOfRay, IsRightWhereProductsAreRounded) {
  std::mt19937_64 random(5);
  const auto draw = [&random](int bits) {
    const std::int64_t range = std::int64_t{1} << bits;
    return static_cast<std::int64_t>(random() % static_cast<std::uint64_t>(2 * range)) - range;
  };
  int n_beside = 0;
  for (int i = 0; i < 5000; ++i) {
    const std::array<std::int64_t, 2> p = {draw(49), draw(49)};
    const std::array<std::int64_t, 2> along = {draw(20), draw(20)};
    const std::array<std::int64_t, 2> off = {draw(1), draw(1)};
    const std::int64_t far = draw(28);
    // (a - p) x (b - p), of a = p + far along + off and b = p + along.
    const std::int64_t det = off[0] * along[1] - off[1] * along[0];
    const auto seen = [&](std::int64_t times, const std::array<std::int64_t, 2>& more,
                          std::int64_t w) {
      return SeenPoint{.x = static_cast<double>(w * (p[0] + times * along[0] + more[0])),
                       .y = static_cast<double>(w * (p[1] + times * along[1] + more[1])),
                       .z = static_cast<double>(w)};
    };
    const Vector2d ray(static_cast<double>(p[0]), static_cast<double>(p[1]));
    if (det == 0) {
      continue;
    }
    ++n_beside;
    EXPECT_EQ(exact_side(Projection::perspective, ray, seen(far, off, 3), seen(1, {}, 5)),
              det > 0 ? 1 : -1);
    EXPECT_EQ(exact_side(Projection::parallel, ray, seen(far, off, 1), seen(1, {}, 1)),
              det > 0 ? 1 : -1);
  }
  EXPECT_GT(n_beside, 3000);
}

/// Of the triangles about a point that rays may pass through each ray passes one.
TEST(SideOfRay, OneTriangleOfAFanIsPassed) {
  const std::array<SeenPoint, 7> ring = {
      SeenPoint{.x = 1.0, .y = 0.0, .z = 2.0}, {.x = 1.0, .y = 1.0, .z = 3.0},
      {.x = 0.0, .y = 1.0, .z = 2.5},          {.x = -1.0, .y = 1.0, .z = 2.0},
      {.x = -1.0, .y = 0.0, .z = 1.5},         {.x = 0.0, .y = -1.0, .z = 2.0},
      {.x = 1.0, .y = -1.0, .z = 2.0}};
  const SeenPoint middle{.x = 0.0, .y = 0.0, .z = 2.0};
  for (const Projection projection : {Projection::perspective, Projection::parallel}) {
    for (const Vector2d& ray : {Vector2d(0.0, 0.0), Vector2d(0.125, 0.0), Vector2d(0.0, 0.125),
                                Vector2d(-0.125, 0.125), Vector2d(0.1, 0.05)}) {
      int n_passed = 0;
      for (std::size_t i = 0; i < ring.size(); ++i) {
        const SeenPoint& a = ring.at(i);
        const SeenPoint& b = ring.at((i + 1) % ring.size());
        n_passed += exact_side(projection, ray, middle, a) > 0 &&
                            exact_side(projection, ray, a, b) > 0 &&
                            exact_side(projection, ray, b, middle) > 0
                        ? 1
                        : 0;
      }
      EXPECT_EQ(n_passed, 1) << ray.transpose();
    }
  }
}

}  // namespace
}  // namespace haarlight::render
