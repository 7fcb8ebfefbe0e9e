// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/extremes.h"
#include "tests/render/volume/volume_scenes.h"
#include "tests/temporary_folder.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using extremes::both;
using extremes::bounded;
using extremes::exact;
using extremes::refused;
using test::Split;
using test::VolumeLight;

constexpr double kExact = 1e-12;
constexpr auto kWhy =
    "crossings of faces are rounded at 2^-53 of the view, times the field's slope";
const Vector3d kEye(1.9, 2.2, 3.1);
const Vector3d kUp(0.1, 0.2, 1.0);

/// A picture of side x side pixels of what is about the middle.
void view_from(const Vector3d& eye, const Vector3d& middle, double size, int side,
               VolumeScene& scene) {
  scene.camera.width = scene.camera.height = side;
  scene.camera.cx = scene.camera.cy = 0.5 * side;
  scene.camera.fx = scene.camera.fy = 0.45 * side * (eye - middle).norm() / size;
  scene.camera.world_from_cam = look_at(eye, middle, kUp);
}

VolumeScene cube_scene(std::size_t n = 4, Split split = Split::six) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(n, split));
  view_from(kEye, Vector3d::Constant(0.5), 1.0, 24, scene);
  return scene;
}

/// The scene with its mesh stretched by a matrix, and what its rays gather then, from near to far as
/// in the unstretched cube.
class Stretched {
 public:
  Stretched(VolumeScene& scene, const Matrix3d& by) : scene_(scene), back_(by.inverse()) {
    for (Vector3d& point : scene.mesh.points) {
      point = by * point;
    }
    truth_.glow = scene.glow;
    truth_.colour = scene.colour;
  }

  /// Largest difference of a picture's values. @param relative  to the largest value
  [[nodiscard]] double error(bool relative = false) {
    const std::vector<VolumeLight> picture = test::render(scene_);
    double worst = 0.0;
    double largest = 0.0;
    std::size_t i = 0;
    for (int y = 0; y < scene_.camera.height; ++y) {
      for (int x = 0; x < scene_.camera.width; ++x, ++i) {
        const VolumeLight truth = truth_of(x, y);
        const VolumeLight& light = picture[i];
        EXPECT_TRUE(light.light.allFinite() && std::isfinite(light.opacity));
        EXPECT_TRUE(light.light.minCoeff() >= 0.0 && light.opacity >= 0.0);
        const double error = std::max((light.light - truth.light).abs().maxCoeff(),
                                      std::abs(light.opacity - truth.opacity));
        worst = error <= worst ? worst : error;  // NaN stays
        largest = std::max({largest, truth.light.maxCoeff(), truth.opacity});
      }
    }
    EXPECT_GT(largest, 0.0);
    return relative ? worst / largest : worst;
  }

 private:
  VolumeLight truth_of(int x, int y) {
    const auto [origin, direction] = test::pixel_ray(scene_, x, y);
    const Vector3d within = back_ * direction;
    std::vector<double> extinctions = scene_.density.values();
    for (double& extinction : extinctions) {
      extinction *= direction.norm() / within.norm();
    }
    const std::span<const double> breakpoints = scene_.density.breakpoints();
    truth_.density = {{breakpoints.begin(), breakpoints.end()}, std::move(extinctions)};
    return test::light_within_cube(truth_, back_ * origin, within);
  }

  VolumeScene& scene_;
  Matrix3d back_;
  VolumeScene truth_;
};

double error_of(VolumeScene& scene, bool relative = false) {
  return Stretched(scene, Matrix3d::Identity()).error(relative);
}

/// The cube by planes at 0, 1e-12, 1e-9, 1e-3, 0.5 and 1 in each direction.
VolumeScene uneven_scene() {
  constexpr std::array kPlanes = {0.0, 1e-12, 1e-9, 1e-3, 0.5, 1.0};
  CellMesh mesh = test::cube_of_tetrahedra(kPlanes.size() - 1);
  for (Vector3d& point : mesh.points) {
    for (double& along : point) {
      along = kPlanes.at(static_cast<std::size_t>(std::lround(5.0 * along)));
    }
  }
  VolumeScene scene = test::scene_of(std::move(mesh));
  view_from(kEye, Vector3d::Constant(0.5), 1.0, 24, scene);
  return scene;
}

/// Every cell with points of its own: all faces are boundary.
CellMesh torn(const CellMesh& mesh) {
  CellMesh made = mesh;
  made.points.clear();
  for (std::size_t i = 0; i < mesh.nodes.size(); ++i) {
    made.points.push_back(mesh.points[mesh.nodes[i]]);
    made.nodes[i] = static_cast<std::uint32_t>(i);
  }
  return made;
}

EXTREMES_OF(volume, "render/volume", "rays through a medium in tetrahedra")

EXTREME(volume, dark) {
  VolumeScene scene = cube_scene();
  scene.density = {{0.0}, {0.0}};
  scene.background.colour = {0.25, 0.5, 0.75};
  for (const VolumeLight& light : test::render(scene)) {
    EXPECT_TRUE((light.light == scene.background.colour).all());
    EXPECT_EQ(light.opacity, 0.0);
  }
  scene.glow = Glow::own;
  scene.colour = {{0.0}, {Array3d::Zero()}};
  for (const VolumeLight& light : test::render(scene)) {
    EXPECT_TRUE((light.light == scene.background.colour).all());
  }
  return exact("no extinction: the background, opacity 0; with a glow of 0, too");
}
EXTREME(volume, one) {
  CellMesh mesh;
  mesh.points = {Vector3d::Zero(), Vector3d::UnitX(), Vector3d::UnitY(), Vector3d::UnitZ()};
  mesh.types = {CellType::tetrahedron};
  mesh.begins = {0};
  mesh.nodes = {0, 1, 2, 3};
  VolumeScene scene = test::scene_of(std::move(mesh));
  double worst = 0.0;
  for (const Vector3d& at : {Vector3d(0.3, 0.3, 0.3), {0.1, 0.2, 0.6}, {0.05, 0.05, 0.05}}) {
    const Vector3d direction = at - kEye;
    test::look_along(kEye, direction, Projection::perspective, scene);
    // Where it enters through x + y + z = 1; it leaves by one of the cube's sides.
    const double near = (1.0 - kEye.sum()) / direction.sum();
    const VolumeLight truth = test::light_within_cube(scene, kEye, direction, near);
    const VolumeLight light = test::render(scene).at(0);
    EXPECT_GT(truth.opacity, 0.1);
    worst = std::max({worst, (light.light - truth.light).abs().maxCoeff(),
                      std::abs(light.opacity - truth.opacity)});
  }
  return bounded(worst, kExact, "one cell, one pixel: error", kWhy);
}
EXTREME(volume, largest) {
  VolumeScene scene = cube_scene();
  scene.density = {{0.0}, {1e300}};
  return refused("an optical depth beyond", [&] { (void)test::render(scene); });
}
EXTREME(volume, odd_size) {
  double worst = 0.0;
  VolumeScene scene = cube_scene(3, Split::five);
  for (const auto& [width, height] : {std::pair{1, 1}, {67, 1}, {1, 33}, {31, 65}}) {
    view_from(kEye, Vector3d::Constant(0.5), 1.0, 32, scene);
    scene.camera = resized(scene.camera, width, height);
    worst = std::max(worst, error_of(scene));
  }
  return bounded(worst, kExact, "1 × 1, 67 × 1, 1 × 33, 31 × 65 pixels: error", kWhy);
}
EXTREME(volume, scale) {
  double worst = 0.0;
  for (const double scale :
       {1e-270, 1e-100, 1e-30, 1e-12, 1e-3, 1e2, 1e6, 1e30, 1e100, 1e270}) {
    for (const test::Transfer transfer : {test::Transfer::hills, test::Transfer::spikes}) {
      VolumeScene scene = cube_scene();
      test::set_transfer(transfer, scene);
      std::vector<double> extinctions = scene.density.values();
      for (double& extinction : extinctions) {
        extinction *= scale;
      }
      const std::span<const double> breakpoints = scene.density.breakpoints();
      scene.density = {{breakpoints.begin(), breakpoints.end()}, std::move(extinctions)};
      worst = std::max(worst, error_of(scene, scale < 1.0));
    }
  }
  double of_lengths = 0.0;
  for (const double scale : {1e-30, 1e-6, 1e6, 1e30}) {
    VolumeScene scene = cube_scene();
    scene.density = {{0.0, 1.0}, {0.5 / scale, 2.0 / scale}};
    view_from(scale * kEye, Vector3d::Constant(0.5 * scale), scale, 24, scene);
    of_lengths =
        std::max(of_lengths, Stretched(scene, Matrix3d(scale * Matrix3d::Identity())).error());
  }
  return both(
      bounded(worst, kExact,
              "extinctions times 1e-270 to 1e270: error, of the largest value below 1", kWhy),
      bounded(of_lengths, kExact, "lengths times 1e±6 and 1e±30: error", kWhy));
}
EXTREME(volume, subnormal) {
  VolumeScene scene = cube_scene();
  double worst = 0.0;
  for (const double extinction : {1e-300, 1e-310, std::numeric_limits<double>::denorm_min()}) {
    scene.density = {{0.0, 1.0}, {0.0, extinction}};
    for (const VolumeLight& light : test::render(scene)) {
      worst = std::max({worst, light.light.maxCoeff(), light.opacity});
      EXPECT_TRUE(light.light.minCoeff() >= 0.0 && light.opacity >= 0.0);
    }
  }
  return bounded(worst, 2e-300,
                 "extinctions of 1e-300, 1e-310 and the least: light and opacity",
                 "√3 times the largest of them");
}
EXTREME(volume, not_finite) {
  const testing::TemporaryFolder folder;
  const std::string source = HAARLIGHT_SOURCE_DIR "/configs/volumes/";
  std::string mesh = read_file(source + "cube.vtu", 1U << 20U);
  const std::string scene = read_file(source + "cube.toml", 1U << 20U);
  mesh.replace(mesh.find("0.0\n"), 4, "nan\n");
  write_file_atomically(folder / "cube.vtu", std::string_view(mesh));
  write_file_atomically(folder / "cube.toml", std::string_view(scene));
  return refused("is nan at point 0", [&] { (void)read_volume_scene(folder / "cube.toml"); });
}
EXTREME(volume, degenerate) {
  double of_cells = 0.0;
  for (const Vector3d& sides :
       {Vector3d(1.0, 1.0, 1e-9), {1e-9, 1.0, 1.0}, {1.0, 1e-9, 1e-9}, {1e9, 1.0, 1e9}}) {
    VolumeScene scene = cube_scene(2);
    const double size = sides.maxCoeff();
    const Vector3d middle = 0.5 * sides;
    // Through the thin direction and across: what is gathered is small.
    scene.density = {{0.0, 1.0}, {0.5 / sides.minCoeff(), 2.0 / sides.minCoeff()}};
    view_from(middle + size * Vector3d(1.4, 1.7, 2.6), middle, size, 24, scene);
    if (sides.y() < 1.0 && sides.z() < 1.0) {  // a needle, in pixels of its width
      scene.camera.fx = scene.camera.fy = 8.0 * (1.0 / sides.z());
    }
    of_cells = std::max(of_cells, Stretched(scene, sides.asDiagonal()).error());
  }
  VolumeScene uneven = uneven_scene();
  const double of_uneven = error_of(uneven);

  double of_eyes = 0.0;
  for (const Vector3d& eye :
       {Vector3d(0.41, 0.53, 0.37), Vector3d(0.5, 0.5, 0.5), Vector3d(0.5, 0.25, 0.1),
        Vector3d(0.25, 0.25, 0.25), Vector3d(0.0, 0.0, 0.0), Vector3d(1.0, 0.5, 0.5)}) {
    VolumeScene scene = cube_scene();
    view_from(eye, Vector3d(0.31, 0.57, 0.63), 0.5, 17, scene);
    scene.camera.fx = scene.camera.fy = 9.0;
    of_eyes = std::max(of_eyes, error_of(scene));
  }
  return both(
      bounded(of_cells, 5e-6, "cells a billion times as long as wide: error",
              "positions are rounded at 2^-53 of 4, 4e-16 beside 1e-9; ten of them"),
      bounded(
          std::max(of_uneven, of_eyes), kExact,
          "cells of 1e-12 beside 0.5; the eye in a cell, on a face, an edge, a vertex: error",
          kWhy));
}
EXTREME(volume, grazing) {
  double worst = 0.0;
  for (const double angle : {1e-3, 1e-6, 1e-9, 1e-12}) {
    for (const Projection projection : {Projection::perspective, Projection::parallel}) {
      VolumeScene scene = cube_scene();
      // Along y, within the planes of faces but for the angle.
      test::look_along({0.375, -2.0, 0.5}, {angle, 1.0, 0.3 * angle}, projection, scene);
      worst = std::max(worst, error_of(scene));
      test::look_along({0.5, -2.0, 0.5}, {angle, 1.0, angle}, projection, scene);
      worst = std::max(worst, error_of(scene));
    }
  }
  return bounded(worst, kExact, "1e-3 to 1e-12 rad beside faces and edges: error", kWhy);
}
EXTREME(volume, far_near) {
  VolumeScene scene = cube_scene();
  view_from(1e6 * kEye, Vector3d::Constant(0.5), 1.0, 24, scene);
  const double far = error_of(scene);
  double near = 0.0;
  for (const double before : {1e-6, 1e-9, 1e-12}) {
    view_from({0.37, 0.41, 1.0 + before}, {0.5, 0.6, 0.1}, 1.0, 24, scene);
    near = std::max(near, error_of(scene));
  }
  return both(bounded(far, 1e-8, "1e6 times as far: error",
                      "positions are rounded at 2^-53 of 4e6; ten of them"),
              bounded(near, kExact, "the eye 1e-6 to 1e-12 before a face: error", kWhy));
}
EXTREME(volume, duplicate) {
  VolumeScene scene = test::scene_of(torn(test::cube_of_tetrahedra(3)));
  view_from(kEye, Vector3d::Constant(0.5), 1.0, 24, scene);
  double worst = error_of(scene);
  scene = cube_scene(1);
  std::vector<double> breakpoints;
  std::vector<double> extinctions;
  for (int i = 0; i < 12; ++i) {  // all within one cell, in six pairs that are one step apart
    breakpoints.push_back(i % 2 == 0 ? 0.2 + 0.05 * i
                                     : std::nextafter(breakpoints.back(), 1.0));
    extinctions.push_back(i % 2 == 0 ? 1.0 : 4.0);
  }
  scene.density = {std::move(breakpoints), std::move(extinctions)};
  worst = std::max(worst, error_of(scene));
  scene.density = {{0.0, 1.0}, {1.0, 3.0}};
  std::ranges::fill(scene.density_field.values, 0.5);
  const std::vector<VolumeLight> picture = test::render(scene);
  scene.density = {{0.0}, {2.0}};
  worst = std::max(worst, test::error_of_cube(scene, picture));
  return bounded(worst, kExact,
                 "every cell with points of its own; breakpoints one step of a double apart; "
                 "one value at all points: error",
                 kWhy);
}
NO_EXTREME(volume, clipped, "it knows no samples")

}  // namespace
}  // namespace haarlight::render
