// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/render/scene/scene.h"
#include "relight/shape/near_alternation.h"
#include "relight/shape/object_mask.h"
#include "tests/relight/shape/known_captures.h"
#include "tests/relight/shape/made_lights.h"

/// Do the stated errors hold on captures whose truth is known? The default of `haarlight
/// shape`: mask and heights of parts found, fit chosen.

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;
using testing::capture_twin;
using testing::degrees_between;
using testing::ground;
using testing::kSynthetic;
using testing::read_rendered;
using testing::Rendered;
using testing::see;
using testing::SeenScene;
using testing::Twin;
using testing::twin_rig;
using testing::vector_at;
namespace fs = std::filesystem;

ShapeOptions default_options() {
  ShapeOptions options;
  options.chooses_fit = true;
  options.finds_part_heights = true;
  options.stereo.fit.has_sigma = true;
  return options;
}

struct Coverage {
  double within = 0.0;  ///< fraction of the normals within two standard errors
  double mean_deg = 0.0;
  double mean_sigma_deg = 0.0;
  std::int64_t n = 0;
};

Coverage cover(const SurfaceEstimate& found, const Image<float>& truth) {
  Coverage result;
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      if (found.state(y, x) != static_cast<int>(PixelState::good)) {
        continue;
      }
      const double error =
          degrees_between(vector_at(found.normal, y, x), vector_at(truth, y, x));
      const auto sigma = double{found.sigma_deg(y, x)};
      result.within += error <= 2.0 * sigma ? 1.0 : 0.0;
      result.mean_deg += error;
      result.mean_sigma_deg += sigma;
      ++result.n;
    }
  }
  const auto n = static_cast<double>(std::max<std::int64_t>(1, result.n));
  result.within /= n;
  result.mean_deg /= n;
  result.mean_sigma_deg /= n;
  return result;
}

void print(const std::string& name, const Coverage& found) {
  std::printf("%s: %lld pixels, error %.2f degrees, sigma %.2f, within two %.3f\n",
              name.c_str(), static_cast<long long>(found.n), found.mean_deg,
              found.mean_sigma_deg, found.within);
}

struct TwinCase {
  std::string name;
  double height_mm = 1.0;  ///< of a part's mean height: smooth parts; steps inside: more
  double most_deg = 90.0;  ///< mean error, by the twin with half as much again
};

render::Scene door_scene() {
  render::Scene scene = ground();
  scene.materials.push_back({"door", Vector3d::Constant(0.35), 0.0, 1.0});
  scene.meshes.push_back(render::make_box({-90, -60, 0}, {80, 110, 18}, 1));
  return scene;
}

render::Scene sphere_scene() {
  render::Scene scene = ground();
  scene.materials.push_back({"plaster", Vector3d::Constant(0.6), 0.0, 1.0});
  scene.meshes.push_back(render::make_sphere({0, 0, 110}, 100.0, 5, 1));
  return scene;
}

render::Scene scene_of(const std::string& name) {
  return name == "door" ? door_scene()
         : name == "sphere"
             ? sphere_scene()
             : render::read_scene(std::string(HAARLIGHT_SOURCE_DIR "/configs/scenes/") + name +
                                  ".toml")
                   .scene;
}

/// All object, and so for two pixels around: rims are left out of a found mask.
bool is_inner(const Image<float>& object, int y, int x) {
  for (int dy = -2; dy <= 2; ++dy) {
    for (int dx = -2; dx <= 2; ++dx) {
      const int v = std::clamp(y + dy, 0, object.height() - 1);
      const int u = std::clamp(x + dx, 0, object.width() - 1);
      if (object(v, u) < 0.99F) {
        return false;
      }
    }
  }
  return true;
}

class TwinCoverage : public ::testing::TestWithParam<TwinCase> {};

TEST_P(TwinCoverage, MaskNormalsAndHeightsAreWhatIsStated) {
  const Rig rig = twin_rig(120, 90);
  const CameraModel& camera = rig.cameras[0].model;
  const render::Scene scene = scene_of(GetParam().name);
  Twin twin = capture_twin(rig, scene);
  const SeenScene seen = see(scene, camera);
  const PixelPoints plane = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  StereoLights lights = twin.lights;
  const ObjectMask mask = mask_by_plane(twin.stack, lights, plane);
  ASSERT_EQ(mask.origin, MaskOrigin::plane);
  double n_object = 0.0;
  double n_missed = 0.0;
  double n_plane = 0.0;
  for (int y = 0; y < camera.height; ++y) {
    for (int x = 0; x < camera.width; ++x) {
      const bool is_object = is_inner(seen.object, y, x);
      n_object += is_object ? 1.0 : 0.0;
      n_missed += is_object && mask.mask(y, x) == 0 ? 1.0 : 0.0;
      n_plane += seen.object(y, x) == 0.0F && mask.mask(y, x) != 0 ? 1.0 : 0.0;
    }
  }
  std::printf("%s: %.0f pixels of object, %.0f missed, %.0f of the plane taken for it\n",
              GetParam().name.c_str(), n_object, n_missed, n_plane);
  EXPECT_LE(n_missed, 0.08 * n_object);  // undersides that no light reaches
  EXPECT_EQ(n_plane, 0.0);
  const Shape shape =
      recover_shape(twin.stack, lights, plane, mask.mask.view(), default_options());
  const Coverage found = cover(shape.surface, seen.normal);
  print(GetParam().name + ", mask found", found);
  EXPECT_GE(found.within, 0.9);
  EXPECT_LE(found.mean_deg, GetParam().most_deg);
  double n_height = 0.0;
  const Parts parts = find_parts(shape.map.is_known.view());
  for (int part = 0; part < parts.n_parts; ++part) {
    double sum = 0.0;
    double n = 0.0;
    for (std::size_t i = 0; i < seen.height.pixels().size(); ++i) {
      if (parts.label.pixels()[i] == part) {
        sum += double{seen.height.pixels()[i]};
        n += 1.0;
      }
    }
    for (const PartHeight& stated : shape.parts) {
      if (stated.is_known && stated.n_pixels == static_cast<std::int64_t>(n) && n > 100.0) {
        std::printf("  part of %.0f pixels: stands %.1f mm, found %.1f +- %.1f\n", n, sum / n,
                    stated.mean_mm, stated.sigma_mm);
        EXPECT_NEAR(stated.mean_mm, sum / n, GetParam().height_mm);
        n_height += n;
      }
    }
  }
  EXPECT_GT(n_height, 0.0);
}

/// The mask one pixel inside the true rim, as bench/relight/shape_score.cpp draws it.
Image<std::uint8_t> drawn_mask(const Image<float>& object) {
  Image<std::uint8_t> mask(object.height(), object.width(), 1);
  for (int y = 1; y + 1 < object.height(); ++y) {
    for (int x = 1; x + 1 < object.width(); ++x) {
      bool is_inside = true;
      for (int i = 0; i < 9; ++i) {
        is_inside = is_inside && object(y + i / 3 - 1, x + i % 3 - 1) > 0.99F;
      }
      mask(y, x) = is_inside ? 1 : 0;
    }
  }
  return mask;
}

/// Leaves of few pixels, at many angles, in each other's shadow, and a mound in the crown's:
/// normals 20 degrees off in the median, heights not found. What is stated must hold there too.
TEST(TreeCoverage, SmallThinPartsAreWithinTwoStandardErrors) {
  const Rig rig = twin_rig(160, 120);
  const CameraModel& camera = rig.cameras[0].model;
  const render::Scene scene = scene_of("tree");
  const Twin twin = capture_twin(rig, scene);
  const SeenScene seen = see(scene, camera);
  const PixelPoints plane = PixelPoints::on_plane(camera, Vector3d::UnitZ(), 0.0);
  const ObjectMask found = mask_by_plane(twin.stack, twin.lights, plane);
  ASSERT_EQ(found.origin, MaskOrigin::plane);
  const Image<std::uint8_t> drawn = drawn_mask(seen.object);
  for (const bool is_drawn : {false, true}) {
    const Shape shape =
        recover_shape(twin.stack, twin.lights, plane,
                      is_drawn ? drawn.view() : found.mask.view(), default_options());
    const Coverage coverage = cover(shape.surface, seen.normal);
    print(is_drawn ? "tree, mask given" : "tree, mask found", coverage);
    EXPECT_GT(coverage.n, 300);
    EXPECT_GE(coverage.within, 0.9);
  }
}

/// Few pixels on many edges: robust fits there have several answers and hop between them, by
/// less than their standard errors make of the heights.
TEST(ShapeRounds, SettleAlsoInASmallPictureOfTheAirplane) {
  for (const int width : {48, 56, 64, 72}) {
    const Rig rig = twin_rig(width, width * 3 / 4);
    const Twin twin = capture_twin(rig, scene_of("airplane"));
    const PixelPoints plane =
        PixelPoints::on_plane(rig.cameras[0].model, Vector3d::UnitZ(), 0.0);
    const ObjectMask mask = mask_by_plane(twin.stack, twin.lights, plane);
    const Shape shape =
        recover_shape(twin.stack, twin.lights, plane, mask.mask.view(), default_options());
    std::printf("%d pixels wide: %zu rounds, the last of %.3f mm\n", width,
                shape.changes.size(), shape.changes.back());
    EXPECT_TRUE(shape.is_settled) << width;
  }
}

INSTANTIATE_TEST_SUITE_P(Objects, TwinCoverage,
                         ::testing::Values(TwinCase{"airplane", 15.0, 7.5},
                                           TwinCase{"blade", 1.0, 0.1},
                                           TwinCase{"blocks", 20.0, 4.5},
                                           TwinCase{"sphere", 1.0, 0.1},
                                           TwinCase{"door", 1.0, 1.5}),
                         [](const auto& of) { return of.param.name; });

class RenderedCoverage : public ::testing::TestWithParam<std::string> {};

TEST_P(RenderedCoverage, NormalsAreWithinTwoStandardErrors) {
  if (!fs::exists(kSynthetic)) {
    GTEST_SKIP() << "no data beside the project: " << kSynthetic;
  }
  const Rendered capture = read_rendered(GetParam(), true);
  const PixelPoints pixels = PixelPoints::orthographic(
      capture.normals.width(), capture.normals.height(), capture.normals.width());
  const Shape shape =
      recover_shape(*capture.stack, capture.lights, pixels, {}, default_options());
  for (const FitScore& score : shape.scores) {
    ShapeOptions options = default_options();
    options.chooses_fit = false;
    options.stereo.fit = score.fit;
    options.stereo.fit.has_sigma = true;
    const Coverage found =
        cover(photometric_stereo(*capture.stack, capture.lights, {}, {}, options.stereo),
              capture.normals);
    std::printf("held out %.4f ", score.held_out);
    print(GetParam() + ", " + score.name, found);
  }
  const Coverage found = cover(shape.surface, capture.normals);
  print(GetParam(), found);
  EXPECT_GE(found.within, 0.9);
}

INSTANTIATE_TEST_SUITE_P(Objects, RenderedCoverage,
                         ::testing::Values("Single_Object1_material4",
                                           "Multi_Object2_material3"),
                         [](const auto& of) { return of.param; });

}  // namespace
}  // namespace haarlight::relight
