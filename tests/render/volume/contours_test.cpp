// SPDX-License-Identifier: Apache-2.0
/// @file
/// Surfaces of constant field value within the medium: planes of a linear field and spheres of a
/// quadratic one, whose crossings are known; and values that lie in the cells' own faces.

#include "render/volume/contours.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "render/volume/volume_ray_caster.h"
#include "tests/render/volume/volume_scenes.h"

namespace haarlight::render {
namespace {

using Eigen::Array3d;
using Eigen::Vector3d;
using test::VolumeLight;

constexpr double kExact = 1e-12;

Contour contour_at(double value) {
  return {.value = value, .colour = {0.9, 0.5, 0.2}, .opacity = 0.4};
}

/// One after the other, from the eye on.
struct InFront {
  VolumeLight sum;
  double transparency = 1.0;
  void add(const Array3d& light, double opacity) {
    sum.light += transparency * light;
    sum.opacity += transparency * opacity;
    transparency *= 1.0 - opacity;
  }
  void add(const VolumeLight& next) { add(next.light, next.opacity); }
  void add(const SurfaceLight& next) { add(next.light, next.opacity); }
};

double difference(const VolumeLight& a, const VolumeLight& b) {
  return std::max((a.light - b.light).abs().maxCoeff(), std::abs(a.opacity - b.opacity));
}

TEST(Contours, ASheetOfGlassSeenFlatAndEdgeOn) {
  Contour contour = contour_at(0.5);
  const SurfaceLight flat = seen_of(contour, 1.0);
  EXPECT_NEAR(flat.opacity, 0.4, 1e-15);
  EXPECT_NEAR(flat.light[0], 0.4 * (0.9 * 0.9 + 0.3), 1e-15);  // its highlight is in full
  const SurfaceLight slanted = seen_of(contour, 0.5);
  EXPECT_NEAR(slanted.opacity, 1.0 - 0.36, 1e-15);  // twice through the sheet
  EXPECT_NEAR(slanted.light[0], 0.64 * 0.9 * (0.2 + 0.35), 1e-15);
  EXPECT_EQ(seen_of(contour, 0.0).opacity, 1.0);
  contour.opacity = 0.0;
  EXPECT_EQ(seen_of(contour, 0.0).opacity, 0.0);
  contour.opacity = 1.0;
  EXPECT_EQ(seen_of(contour, 0.3).opacity, 1.0);
}

TEST(Contours, OfALinearFieldArePlanesInCellsOfEveryType) {
  for (const CellType type : {CellType::tetrahedron, CellType::hexahedron, CellType::wedge,
                              CellType::pyramid, CellType::quadratic_tetrahedron}) {
    VolumeScene scene = test::scene_of(test::cube_of(type, 2));
    scene.contour_field = test::linear_field(scene.mesh);
    scene.contours = {contour_at(0.35), contour_at(0.6)};
    scene.contours[1].colour = {0.1, 0.2, 0.8};
    double worst = 0.0;
    int n_crossed = 0;
    for (const double near_mm : {0.0, 3.0}) {
      test::look_at_cube({1.9, 2.2, 3.1}, 24, scene);
      scene.optics.near_mm = near_mm;
      const std::vector<VolumeLight> picture = test::render(scene);
      for (int y = 0; y < 24; ++y) {
        for (int x = 0; x < 24; ++x) {
          const auto [origin, direction] = test::pixel_ray(scene, x, y);
          auto [near, far] = test::within_cube(origin, direction);
          near = std::max(near, near_mm);
          const Vector3d slope = Vector3d(1.0, 2.0, 3.0) / 6.0;
          InFront truth;
          for (const std::size_t i : {1U, 0U}) {  // the eye is where the field is large
            const double t =
                (scene.contours[i].value - slope.dot(origin)) / slope.dot(direction);
            if (t > near && t < far) {
              truth.add(test::light_within_cube(scene, origin, direction, near, t));
              truth.add(seen_of(scene.contours[i],
                                std::abs(slope.normalized().dot(direction.normalized()))));
              near = t;
              ++n_crossed;
            }
          }
          truth.add(test::light_within_cube(scene, origin, direction, near, far));
          worst = std::max(
              worst, difference(picture[static_cast<std::size_t>(y * 24 + x)], truth.sum));
        }
      }
    }
    EXPECT_LE(worst, kExact) << shape_of(type).name;
    EXPECT_GT(n_crossed, 300);
  }
}

TEST(Contours, OfAQuadraticFieldAreSpheres) {
  VolumeScene scene = test::scene_of(test::cube_of(CellType::quadratic_tetrahedron, 2));
  const Vector3d centre(0.45, 0.55, 0.5);
  scene.contour_field = scene.density_field;
  for (std::size_t i = 0; i < scene.mesh.points.size(); ++i) {
    scene.contour_field.values[i] = (scene.mesh.points[i] - centre).squaredNorm();
  }
  scene.density = {{0.0}, {0.0}};  // the surface alone
  scene.contours = {contour_at(0.3 * 0.3)};
  test::look_at_cube({1.9, 2.2, 3.1}, 40, scene);
  const std::vector<VolumeLight> picture = test::render(scene);
  double worst = 0.0;
  int n_hit = 0;
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 40; ++x) {
      const auto [origin, direction] = test::pixel_ray(scene, x, y);
      const Vector3d forward = direction.normalized();
      const double along = (centre - origin).dot(forward);
      const double off = (origin + along * forward - centre).squaredNorm();
      InFront truth;
      if (off < 0.09) {
        const double half = std::sqrt(0.09 - off);
        truth.add(seen_of(scene.contours[0], half / 0.3));  // in front and behind alike
        truth.add(seen_of(scene.contours[0], half / 0.3));
        ++n_hit;
      }
      // Near the outline a rounding of 1e-16 of the field is one of 1e-16/half of the cosine.
      const double half = std::sqrt(std::abs(0.09 - off));
      if (half > 1e-3) {
        worst = std::max(worst,
                         difference(picture[static_cast<std::size_t>(y * 40 + x)], truth.sum));
      }
    }
  }
  std::printf("largest error %.2g\n", worst);
  EXPECT_LE(worst, kExact);
  EXPECT_GT(n_hit, 80);
}

/// The field z, whose values at the grid's planes are those of whole faces.
TEST(Contours, AValueInTheCellsFacesCountsOnce) {
  for (const FaceForm faces : {FaceForm::tetrahedra_where_all_are, FaceForm::general}) {
    for (const CellType type : {CellType::tetrahedron, CellType::hexahedron, CellType::wedge,
                                CellType::quadratic_tetrahedron}) {
      VolumeScene scene = test::scene_of(test::cube_of(type, 4));
      scene.density = {{0.0}, {0.0}};
      scene.contour_field = scene.density_field;
      for (std::size_t i = 0; i < scene.mesh.points.size(); ++i) {
        scene.contour_field.values[i] = scene.mesh.points[i].z();
      }
      // Within the mesh, and where it begins and ends.
      scene.contours = {contour_at(0.25), contour_at(0.0), contour_at(1.0)};
      scene.camera.width = scene.camera.height = 7;
      scene.camera.cx = scene.camera.cy = 0.0;
      scene.optics.pixel_mm = 0.125;
      scene.camera.world_from_cam.translation() = Vector3d(0.0, 0.0, -2.0);
      for (const VolumeLight& light : test::render(scene, {.faces = faces})) {
        EXPECT_NEAR(light.opacity, 1.0 - std::pow(0.6, 3.0), kExact);
      }
      // A crest: |z - 1/4|, met and not passed.
      for (std::size_t i = 0; i < scene.mesh.points.size(); ++i) {
        scene.contour_field.values[i] = std::abs(scene.mesh.points[i].z() - 0.25);
      }
      scene.contours = {contour_at(0.0)};
      for (const VolumeLight& light : test::render(scene, {.faces = faces})) {
        EXPECT_NEAR(light.opacity, 0.4, kExact);
      }
    }
  }
}

}  // namespace
}  // namespace haarlight::render
