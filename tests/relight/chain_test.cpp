// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/direct/picture.h"
#include "haarlight/render/light/rig_lights.h"
#include "relight/basis/plate/plate.h"
#include "sim/transport.h"
#include "tests/relight/ball_on_ground.h"
#include "tests/temporary_folder.h"

/// From the twin to the relit picture, against truths that the chain itself has no part in.

namespace haarlight::relight {
namespace {

using Eigen::Vector3d;

constexpr int kWidth = 40;
constexpr int kHeight = 30;

/// The twin's stack in units of its scale.
struct Twin {
  MemoryStack stack{{kWidth, kHeight, 1, 64}};
  double scale = 1.0;
};

Twin capture(const Rig& rig, const render::Scene& scene, const std::filesystem::path& cache) {
  sim::TransportOptions options;
  options.cache_folder = cache;
  const sim::Transport transport = sim::make_transport(rig, 0, scene, options);
  Twin twin;
  twin.scale = transport.scale();
  for (int k = 0; k < 64; ++k) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        twin.stack.at(0, y, x, k) =
            static_cast<float>(double{transport.plane(k)(y, x)} / twin.scale);
      }
    }
  }
  return twin;
}

CompressSource source_of(const Twin& twin, const Rig& rig, const StackSource* plate) {
  CompressSource source;
  source.stack = &twin.stack;
  source.plate = plate;
  source.plate_origin = PlateOrigin::computed;
  source.grid = {8, 8};
  source.rig_toml = rig.text;
  source.name = "twin";
  return source;
}

/// What the mono sensor makes of a picture in red, green and blue.
std::vector<float> mono(const Image<float>& picture, double scale) {
  std::vector<float> values;
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      values.push_back(static_cast<float>(
          (double{picture(y, x, 0)} + double{picture(y, x, 1)} + double{picture(y, x, 2)}) /
          (3.0 * scale)));
    }
  }
  return values;
}

TEST(Chain, NineRelitLightsAreTheSceneRenderedUnderThem) {
  const testing::TemporaryFolder folder;
  const Rig rig = test::rig_of_64_lights(kWidth, kHeight);
  const render::Scene scene = test::glossy_ball_on_ground();
  const Twin twin = capture(rig, scene, folder.path());
  const std::vector<int> nine = {9, 12, 14, 33, 36, 38, 49, 52, 54};
  std::vector<Vector3d> weights(64, Vector3d::Zero());
  LightWeights w = LightWeights::Zero(64, 1);
  for (const int k : nine) {
    weights[static_cast<std::size_t>(k)].setOnes();
    w(k, 0) = 1.0;
  }
  // Directly: all nine at once, other random numbers, 32 x 32 strata per light. The same with
  // the transport's own 16 x 16 tells how far apart two such pictures are by chance.
  render::LitOptions options;
  options.direct.seed = 20261121;
  const render::LitPicture coarse = render::render_lit(
      scene, rig.cameras[0].model, render::rig_lights(rig), weights, options);
  options.direct.mixed_grid = 32;
  const render::LitPicture direct = render::render_lit(
      scene, rig.cameras[0].model, render::rig_lights(rig), weights, options);
  const std::vector<float> truth = mono(direct.radiance, twin.scale);
  const double chance = compare(mono(coarse.radiance, twin.scale), truth).relative_l2;
  ASSERT_GT(chance, 1e-5);  // else the two are not drawn apart
  ASSERT_LT(chance, 3e-3);
  const ComputedPlate plate(rig);
  for (const double error : {0.0, 0.001, 0.01}) {
    const auto file = folder / "twin.hlb";
    const CompressSummary summary = compress_stack(
        source_of(twin, rig, error > 0.0 ? &plate : nullptr), file, {.relative_l2 = error});
    const RelitPicture relit = relight(BasisFile::open(file), w);
    const Achieved found = compare(relit.picture.pixels(), truth);
    std::printf(
        "nine lights, compressed to %g: %.2e from the direct rendering (%.1f dB), of "
        "which chance %.2e; promised %.2e\n",
        error, found.relative_l2, found.psnr_db, chance, relit.bound.relative_l2);
    EXPECT_LE(found.relative_l2, relit.bound.relative_l2 + 2.0 * chance);
    EXPECT_LE(summary.header.achieved.relative_l2, error);
    std::filesystem::remove(file);
  }
}

TEST(Chain, EnvironmentOfOneLightGivesThatLightsPicture) {
  const testing::TemporaryFolder folder;
  const Rig rig = test::rig_of_64_lights(kWidth, kHeight);
  const Twin twin = capture(rig, test::glossy_ball_on_ground(), folder.path());
  constexpr int kLight = 10;
  // One bright texel, all of it within the light's cell: 0.012 rad in 0.1 rad.
  const LightElement light = light_element(rig, kLight);
  const Vector3d to = (light.centre - rig.object_centre).normalized();
  Image<float> picture(256, 512, 1);
  const int row = static_cast<int>(std::acos(to.z()) / std::numbers::pi * 256.0);
  const int column = static_cast<int>((std::numbers::pi - std::atan2(to.y(), to.x())) /
                                      (2.0 * std::numbers::pi) * 512.0);
  picture(row, column) = 1e6F;
  const EnvironmentWeights found =
      rig_weights(render::Environment::from_picture(std::move(picture), "made"), rig);
  EXPECT_EQ((found.weights.array() != 0.0).count(), 1);
  EXPECT_EQ(found.missing_fraction, 0.0);
  // L dw of that texel, over the irradiance that the light gives.
  const double theta = std::numbers::pi / 256.0;
  const double texel =
      (std::cos(row * theta) - std::cos((row + 1) * theta)) * 2.0 * std::numbers::pi / 512.0;
  const double weight = 1e6 * texel / facing_irradiance(light, rig.object_centre);
  EXPECT_NEAR(found.weights(kLight, 0) / weight, 1.0, 1e-9);
  const ComputedPlate plate(rig);
  for (const double error : {0.0, 0.01}) {
    const auto file = folder / "twin.hlb";
    (void)compress_stack(source_of(twin, rig, error > 0.0 ? &plate : nullptr), file,
                         {.relative_l2 = error});
    const RelitPicture relit = relight(BasisFile::open(file), found.weights);
    LightWeights one = LightWeights::Zero(64, 1);
    one(kLight, 0) = weight;
    const Achieved to_truth =
        compare(relit.picture.pixels(), relight_stack(twin.stack, one).pixels());
    EXPECT_LE(to_truth.relative_l2, relit.bound.relative_l2 + 1e-6);
    EXPECT_LE(relit.bound.relative_l2, 10.0 * error);
    std::filesystem::remove(file);
  }
}

}  // namespace
}  // namespace haarlight::relight
