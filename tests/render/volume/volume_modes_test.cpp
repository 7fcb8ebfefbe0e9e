// SPDX-License-Identifier: Apache-2.0
/// @file
/// Pictures by each mode beside the exact ones: their bounds, and the order of their errors.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "core/random.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;

double uniform(std::uint64_t what, std::uint64_t i) { return uniform_unit(hash_key(what, i)); }

struct ModePicture {
  std::vector<test::VolumeLight> pixels;
  std::optional<double> bound;
  double left_out = 0.0;
  VolumeCounts counts;
};

ModePicture picture_of(const VolumeScene& scene, const VolumeOptions& options) {
  const VolumeRayCaster caster(scene, options);
  ModePicture picture{.pixels = test::picture_by(caster, scene)};
  picture.bound = caster.error_bound();
  picture.left_out = caster.left_out();
  picture.counts = caster.counts();
  return picture;
}

/// Of red, green and blue.
double light_off(const ModePicture& a, const ModePicture& b) {
  double off = 0.0;
  for (std::size_t i = 0; i < a.pixels.size(); ++i) {
    off = std::max(off, (a.pixels[i].light - b.pixels[i].light).abs().maxCoeff());
  }
  return off;
}

bool is_finite(const ModePicture& picture) {
  return std::ranges::all_of(picture.pixels, [](const test::VolumeLight& pixel) {
    return pixel.light.allFinite() && std::isfinite(pixel.opacity);
  });
}

/// Cells of any type, transfer functions of any rows, both glows, thin to opaque, some with surfaces.
VolumeScene random_scene(std::uint64_t i) {
  constexpr std::array kTypes = {CellType::tetrahedron, CellType::hexahedron, CellType::wedge,
                                 CellType::pyramid, CellType::quadratic_tetrahedron};
  CellMesh mesh = test::cube_of(kTypes.at(i % kTypes.size()), 1 + i % 3);
  VolumeScene scene = test::scene_of(std::move(mesh));
  const auto draw = [&](std::uint64_t k) { return uniform(100 + k, i); };
  if (i % 2 == 1) {  // of higher degree within cells
    for (std::size_t p = 0; p < scene.density_field.values.size(); ++p) {
      const Vector3d& at = scene.mesh.points[p];
      scene.density_field.values[p] = (at.x() * at.x() + 2.0 * at.y() * at.z() + at.z()) / 4.0;
      scene.colour_field.values[p] = (at.x() * at.y() + 2.0 * at.z() * at.z()) / 3.0;
    }
  }
  const double scale = std::pow(10.0, 4.0 * draw(0) - 2.0);
  const std::size_t n_rows = 1 + static_cast<std::size_t>(6.0 * draw(1));
  std::vector<double> at;
  std::vector<double> rho;
  std::vector<Array3d> k;
  for (std::size_t row = 0; row < n_rows; ++row) {
    at.push_back((static_cast<double>(row) + 0.9 * draw(10 + row)) /
                 static_cast<double>(n_rows));
    rho.push_back(draw(20 + row) < 0.2 ? 0.0 : scale * draw(30 + row));
    k.emplace_back(draw(40 + row), draw(50 + row), 3.0 * draw(60 + row));
  }
  scene.density = PiecewiseLinear<double>(at, rho);
  scene.colour = PiecewiseLinear<Array3d>(at, k);
  scene.glow = draw(2) < 0.5 ? Glow::own : Glow::chromaticity;
  scene.background.colour = Array3d(draw(3), 0.0, draw(4));
  if (i % 4 == 0) {
    scene.contour_field = scene.density_field;
    scene.contours = {{.value = 0.3, .colour = Array3d(1.0, draw(7), 0.2), .opacity = 0.4},
                      {.value = 0.6, .colour = Array3d(0.1, 1.0, draw(8)), .opacity = 0.9}};
  }
  test::look_at_cube(Vector3d(1.9 + draw(5), 2.2 - 4.0 * draw(6), 3.1), 12, scene);
  return scene;
}

constexpr std::uint64_t kScenes = 30;

TEST(VolumeModes, PicturesStayWithinTheBoundsThatAreReported) {
  int n_bounded = 0;
  double worst_of_series = 0.0;
  for (std::uint64_t i = 0; i < kScenes; ++i) {
    const VolumeScene scene = random_scene(i);
    const ModePicture exact = picture_of(scene, {});
    for (const VolumeOptions& options :
         {VolumeOptions{.rule = {.mode = VolumeMode::gauss}},
          VolumeOptions{.rule = {.mode = VolumeMode::gauss, .points = 3, .piece_depth = 0.1}},
          VolumeOptions{.rule = {.mode = VolumeMode::gauss, .points = 16, .piece_depth = 2.0}},
          VolumeOptions{.rule = {.mode = VolumeMode::series}},
          VolumeOptions{.max_error = 1e-3, .rule = {.mode = VolumeMode::series}},
          VolumeOptions{.max_error = 1e-7, .rule = {.mode = VolumeMode::series}}}) {
      const ModePicture picture = picture_of(scene, options);
      ASSERT_TRUE(is_finite(picture)) << i;
      const double off = light_off(picture, exact);
      if (picture.bound) {
        ++n_bounded;
        EXPECT_LE(off, *picture.bound) << i << ", " << to_string(options.rule.mode);
      }
      if (options.rule.mode == VolumeMode::series) {
        ASSERT_TRUE(picture.bound);
        if (options.max_error > 0.0) {
          EXPECT_LE(*picture.bound, options.max_error) << i;
        } else {
          worst_of_series = std::max(worst_of_series, off);
        }
      }
    }
  }
  std::printf("series to rounding: off by up to %.2g\n", worst_of_series);
  EXPECT_GE(n_bounded, 150);  // of 180: rules of few points have none below 1 in curved cells
  EXPECT_LE(worst_of_series, 1e-11);
}

TEST(VolumeModes, AnErrorThatIsAllowedIsKeptByExactPictures) {
  std::uint64_t n_ended = 0;
  for (std::uint64_t i = 0; i < kScenes; ++i) {
    const VolumeScene scene = random_scene(i);
    const ModePicture exact = picture_of(scene, {});
    for (const double allowed : {1e-2, 1e-4, 1e-8}) {
      const ModePicture picture = picture_of(scene, {.max_error = allowed});
      EXPECT_LE(picture.left_out, allowed * (1.0 + 1e-12)) << i;
      EXPECT_LE(light_off(picture, exact), picture.left_out + 1e-13) << i << " " << allowed;
      n_ended += picture.counts.opaque_rays;
    }
  }
  EXPECT_GE(n_ended, 200U);
}

/// Linear fields in cubes of half the side: cells of half the size, so a quarter of the error.
TEST(VolumeModes, MeanColoursAreOffByTheSquareOfTheCellSize) {
  for (const VolumeMode mode : {VolumeMode::approximate, VolumeMode::approximate_unsliced}) {
    double first = 0.0;
    double last = 0.0;
    for (const std::size_t n : {std::size_t{4}, std::size_t{8}, std::size_t{16}}) {
      VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(n));
      test::look_at_cube(Vector3d(1.9, 2.2, 3.1), 40, scene);
      const ModePicture exact = picture_of(scene, {});
      const ModePicture picture = picture_of(scene, {.rule = {.mode = mode}});
      EXPECT_FALSE(picture.bound);
      double sum = 0.0;
      for (std::size_t i = 0; i < exact.pixels.size(); ++i) {
        sum += (picture.pixels[i].light - exact.pixels[i].light).square().sum();
      }
      last = std::sqrt(sum);
      first = n == 4 ? last : first;
    }
    std::printf("%s: error falls with the cell size to the power of %.2f\n",
                std::string(to_string(mode)).c_str(), std::log2(first / last) / 2.0);
    // Cells are few at first: 2 in the limit.
    EXPECT_NEAR(std::log2(first / last) / 2.0, 2.0, 0.25);
  }
}

TEST(VolumeModes, SlicedMeanColoursAreNearerThanUnslicedOnes) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(3));
  test::look_at_cube(Vector3d(1.9, 2.2, 3.1), 30, scene);
  const ModePicture exact = picture_of(scene, {});
  const auto off = [&](VolumeMode mode) {
    return light_off(picture_of(scene, {.rule = {.mode = mode}}), exact);
  };
  const double sliced = off(VolumeMode::approximate);
  EXPECT_GT(sliced, 1e-3);
  EXPECT_GT(off(VolumeMode::approximate_unsliced), 1.5 * sliced);
}

/// The paper's formulas have 0/0 where nothing absorbs, and a glow of its own is there all the same.
TEST(VolumeModes, FailuresOfThePaperAreCountedAndNoneIsWritten) {
  VolumeScene scene = test::scene_of(test::cube_of_tetrahedra(2));
  scene.density = PiecewiseLinear<double>({0.4, 0.6}, {0.0, 2.0});
  scene.glow = Glow::own;
  test::look_at_cube(Vector3d(1.9, 2.2, 3.1), 30, scene);
  const ModePicture exact = picture_of(scene, {});
  const ModePicture paper = picture_of(scene, {.rule = {.mode = VolumeMode::paper}});
  EXPECT_GT(paper.counts.rule.not_finite, 100U);
  EXPECT_TRUE(is_finite(paper));
  // The mean colour is exact there: T = 1.
  EXPECT_LE(light_off(paper, exact), 1e-5);
  EXPECT_GE(light_off(paper, exact), 1e-9);
}

/// Of a field that bends, within one row of its functions: five points over each cell [Williams98].
TEST(VolumeModes, FivePointsInOnePieceAreThoseOfTheSegment) {
  VolumeScene scene = test::scene_of(test::cube_of(CellType::quadratic_tetrahedron, 1));
  for (std::size_t p = 0; p < scene.density_field.values.size(); ++p) {
    const Vector3d& at = scene.mesh.points[p];
    scene.density_field.values[p] = at.squaredNorm() / 3.0;
    scene.colour_field.values[p] = at.squaredNorm() / 3.0;
  }
  test::look_at_cube(Vector3d(1.9, 2.2, 3.1), 20, scene);
  const auto off_at = [&](double scale) {
    scene.density = PiecewiseLinear<double>({0.0, 1.0}, {scale, 2.0 * scale});
    scene.colour = PiecewiseLinear<Array3d>({0.0, 1.0}, {Array3d::Zero(), Array3d::Ones()});
    return light_off(picture_of(scene, {.rule = {.mode = VolumeMode::paper}}),
                     picture_of(scene, {}));
  };
  const double thin = off_at(0.5);
  const double dense = off_at(20.0);
  std::printf("five points: off by %.2g, and by %.2g where opaque\n", thin, dense);
  EXPECT_LE(thin, 1e-5);
  EXPECT_GE(thin, 1e-13);
  EXPECT_GE(dense, 1e-2);
}

}  // namespace
}  // namespace haarlight::render
