// SPDX-License-Identifier: Apache-2.0
#include "relight/study/capture_regions.h"

#include <cmath>
#include <filesystem>
#include <vector>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "haarlight/core/picture/image_io.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

/// 16 x 16 square lights 900 mm above the plane, as the cube has them.
std::vector<StudyLight> array16() {
  std::vector<StudyLight> lights;
  for (int row = 0; row < 16; ++row) {
    for (int col = 0; col < 16; ++col) {
      StudyLight light;
      light.is_position = true;
      light.coordinates = Vector3d((col - 7.5) * 60.0, (row - 7.5) * 60.0, 900.0);
      light.emits = -Vector3d::UnitZ();
      light.strength = 56.0 * 56.0;
      lights.push_back(light);
    }
  }
  return lights;
}

/// A surface of normal n at `at`, matte plus a lobe, hidden from the first `n_hidden` lights.
std::vector<float> pixel(const std::vector<StudyLight>& lights, const Vector3d& at,
                         const Vector3d& n, double ks, int n_hidden, double noise = 0.0) {
  const Vector3d eye = (Vector3d(0, -560, 520) - at).normalized();
  std::vector<float> values;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const Vector3d to = lights[k].coordinates - at;
    const Vector3d d = to.normalized();
    const double irradiance =
        std::max(0.0, n.dot(d)) * lights[k].strength * d.z() / to.squaredNorm();
    const double lobe =
        ks * 68.0 / 25.13 * std::pow(std::max(0.0, n.dot((d + eye).normalized())), 60.0);
    double value = static_cast<int>(k) < n_hidden ? 0.0 : irradiance * (0.6 / 3.1416 + lobe);
    value *= 1.0 + noise * standard_normal(hash_key(3, k));
    values.push_back(static_cast<float>(value));
  }
  return values;
}

TEST(Regions, AMatteSurfaceUnderEveryLightIsDiffuse) {
  const auto lights = array16();
  const Vector3d at(40, -30, 0);
  const PixelVerdict found = classify_pixel(pixel(lights, at, Vector3d::UnitZ(), 0.0, 0),
                                            light_factors(lights, at), 0.0);
  EXPECT_EQ(found.region, Region::diffuse);
  EXPECT_NEAR(found.matte.normalized().z(), 1.0, 1e-9);
  EXPECT_EQ(found.attached, 0.0);
  EXPECT_EQ(found.cast, 0.0);
  EXPECT_NEAR(found.excess, 0.0, 1e-6);
}

TEST(Regions, HiddenLightsAreACastShadowToTheLight) {
  const auto lights = array16();
  const Vector3d at(40, -30, 0);
  for (const int n_hidden : {8, 40, 100}) {
    const PixelVerdict found =
        classify_pixel(pixel(lights, at, Vector3d::UnitZ(), 0.0, n_hidden, 0.01),
                       light_factors(lights, at), 0.0);
    EXPECT_EQ(found.region, Region::cast) << n_hidden;
    EXPECT_EQ(found.cast, n_hidden / 256.0);
    EXPECT_EQ(found.attached, 0.0);
  }
}

TEST(Regions, ASurfaceTurnedAwayHasAttachedShadowWhereItsNormalSays) {
  const auto lights = array16();
  const Vector3d at(0, 0, 60);
  const Vector3d n = Vector3d(0.9, 0.1, 0.15).normalized();
  // Classified as if it lay on the plane: the rule does not know its height.
  const PixelVerdict found = classify_pixel(pixel(lights, at, n, 0.0, 0),
                                            light_factors(lights, Vector3d(0, 64, 0)), 0.0);
  EXPECT_EQ(found.region, Region::attached);
  int behind = 0;
  for (const StudyLight& light : lights) {
    behind += n.dot(light.coordinates - at) <= 0.0 ? 1 : 0;
  }
  EXPECT_NEAR(found.attached, behind / 256.0, 0.03);
}

TEST(Regions, AHighlightIsSpecularAndItsShadowToo) {
  const auto lights = array16();
  const Vector3d at(0, 0, 0);
  // Tilted so that the lobe meets the array.
  const Vector3d n = (Vector3d(0, -560, 520).normalized() + Vector3d(0, 0.2, 1)).normalized();
  const PixelVerdict found =
      classify_pixel(pixel(lights, at, n, 0.3, 0), light_factors(lights, at), 0.0);
  EXPECT_EQ(found.region, Region::specular);
  EXPECT_GT(found.excess, 2.0 * RegionRules{}.excess);
}

TEST(Regions, OfASphereOverAPlaneAreThoseOfItsGeometry) {
  // A matte ball over a matte plane in closed form: which lights each point faces and sees is
  // known exactly, apart from the rule.
  test::MadeScene scene{40, 36, 16, 1, true, 0.01};
  const MemoryStack& stack = test::make_stack(scene);
  const auto lights = array16();
  const Vector3d ball(20.0, -10.0, 80.0);
  int n_right = 0;
  int n_clear = 0;
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      const Vector3d ground(-200.0 + 400.0 * (x + 0.5) / scene.width,
                            200.0 - 400.0 * (y + 0.5) / scene.height, 0.0);
      const double planar = (ground - ball).head<2>().squaredNorm();
      const bool is_on_ball = planar < 50.0 * 50.0;
      Vector3d point = ground;
      Vector3d normal = Vector3d::UnitZ();
      if (is_on_ball) {
        point.z() = ball.z() + std::sqrt(50.0 * 50.0 - planar);
        normal = (point - ball).normalized();
      }
      int n_away = 0;
      int n_hidden = 0;
      for (const StudyLight& light : lights) {
        n_away += normal.dot(light.coordinates - point) <= 0.0 ? 1 : 0;
        n_hidden +=
            !is_on_ball && test::is_blocked(point, light.coordinates, ball, 50.0) ? 1 : 0;
      }
      // Clear cases: none, or at least 4 % (the rule's border is 2 %).
      const int n_event = std::max(n_away, n_hidden);
      if (n_event != 0 && n_event < 11) {
        continue;
      }
      const Region truth = n_event == 0        ? Region::diffuse
                           : n_away > n_hidden ? Region::attached
                                               : Region::cast;
      const std::size_t at = static_cast<std::size_t>(y * scene.width + x) * 256;
      const PixelVerdict found =
          classify_pixel(stack.values().subspan(at, 256), light_factors(lights, ground), 0.0);
      ++n_clear;
      n_right += found.region == truth ? 1 : 0;
    }
  }
  EXPECT_GT(n_clear, 1100);
  EXPECT_GE(n_right, 0.97 * n_clear) << n_right << " of " << n_clear;
}

TEST(Regions, DirectionsAloneWillDo) {
  std::vector<StudyLight> lights(40);
  std::vector<float> values;
  for (std::size_t k = 0; k < lights.size(); ++k) {
    const double z = (double(k) + 0.5) / 40.0;
    const double r = std::sqrt(1.0 - z * z);
    lights[k].coordinates =
        Vector3d(r * std::cos(2.4 * double(k)), r * std::sin(2.4 * double(k)), z);
    values.push_back(k >= 30 ? 0.0F : static_cast<float>(0.5 * z));
  }
  const PixelVerdict found =
      classify_pixel(values, light_factors(lights, Vector3d::Zero()), 0.0);
  EXPECT_EQ(found.region, Region::cast);
  EXPECT_EQ(found.cast, 0.25);
}

TEST(Regions, DarkPixelsAndFewLightsTellNothing) {
  const auto lights = array16();
  const Eigen::Matrix3Xd factors = light_factors(lights, Vector3d::Zero());
  EXPECT_EQ(classify_pixel(std::vector<float>(256), factors, 0.0).region, Region::none);
  EXPECT_EQ(classify_pixel(std::vector<float>(256, 1e-6F), factors, 1.0).region, Region::none);
  std::vector<float> three(256);
  three[0] = three[1] = three[2] = 1.0F;
  EXPECT_EQ(classify_pixel(three, factors, 0.0).region, Region::none);
  EXPECT_EQ(classify_pixel(std::vector<float>{1.0F},
                           light_factors({StudyLight{}}, Vector3d::Zero()), 0.0)
                .region,
            Region::none);
}

TEST(Regions, PaintedRegionsComeBack) {
  const testing::TemporaryFolder folder;
  const std::vector<Region> regions = {Region::none,     Region::specular, Region::diffuse,
                                       Region::attached, Region::cast,     Region::diffuse};
  write_image(folder / "regions.png", paint_regions(regions, 3, 2).view());
  EXPECT_EQ(read_region_picture(folder / "regions.png", 3, 2), regions);
  EXPECT_THROW((void)read_region_picture(folder / "regions.png", 2, 3), Error);
  Image<float> other(2, 3, 3);
  for (float& v : other.pixels()) {
    v = 1.0F;  // white is no region
  }
  write_image(folder / "white.png", other.view());
  EXPECT_THROW((void)read_region_picture(folder / "white.png", 3, 2), Error);
}

}  // namespace
}  // namespace haarlight::relight
