// SPDX-License-Identifier: Apache-2.0
/// How far the stated bound on the coding error lies above the error: over random lights and
/// real skies.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <utility>

#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/relight/basis/compress.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/relight/light/light_weights.h"
#include "haarlight/render/light/cubemap.h"
#include "tests/relight/basis/made_stack.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

constexpr int kLights = 1024;
// Measured: 1.20 and 1.19. Errors that have nothing in common seem to, over 27 648 pixels: 1.19
// without any vector (1 + sqrt(1024 / 27648) of their largest common part).
constexpr double kMedian = 1.3;

const MemoryStack& stack() {
  return test::make_stack({.width = 192, .height = 144, .grid = 32, .noise = 0.02});
}

/// Stated error / error of each light's picture against the stack, both in doubles.
std::vector<double> ratios(const BasisFile& basis, const std::vector<LightWeights>& lights) {
  const std::vector<RelitPicture> pictures = relight(basis, lights);
  std::vector<double> found;
  for (std::size_t e = 0; e < lights.size(); ++e) {
    const Image<float> truth = relight_stack(stack(), lights[e]);
    double energy = 0.0;
    for (std::size_t i = 0; i < truth.pixels().size(); ++i) {
      const double off = double{pictures[e].picture.pixels()[i]} - double{truth.pixels()[i]};
      energy += off * off;
    }
    // Pictures are rounded to float: 6e-8 of their norm, each.
    const double own = 1.2e-7 * pictures[e].bound.picture_norm;
    const double error = std::max(std::sqrt(energy) - own, 1e-300);
    found.push_back(pictures[e].bound.coded / error);
    EXPECT_GE(found.back(), 1.0 - 2.0 * own / error) << e;
  }
  return found;
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

class TightBound : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder;
    static const MemoryStack& plate =
        test::make_stack({.width = 192, .height = 144, .grid = 32, .has_sphere = false});
    (void)compress_stack(test::made_source(stack(), 32, &plate), folder_->path() / "a.hlb",
                         {.relative_l2 = 0.01});
  }
  static void TearDownTestSuite() { delete folder_; }
  static BasisFile basis() { return BasisFile::open(folder_->path() / "a.hlb"); }
  static test::TemporaryFolder* folder_;  // NOLINT(readability-identifier-naming): a member
};
test::TemporaryFolder* TightBound::folder_ = nullptr;

/// Uniform, sparse, 10^6 to 1, of both signs, smooth, one face's half: 210 in all.
TEST_F(TightBound, HoldsRandomLightsCloseAndNeverBelow) {
  std::vector<LightWeights> lights;
  for (std::uint64_t i = 0; i < 210; ++i) {
    LightWeights w = LightWeights::Zero(kLights, 1);
    const double at = 32.0 * uniform_unit(hash_key(i, 1));
    const double size = 1.0 + 12.0 * uniform_unit(hash_key(i, 2));
    for (int k = 0; k < kLights; ++k) {
      const std::uint64_t key = hash_key(i, 3, static_cast<std::uint64_t>(k));
      const double unit = uniform_unit(key);
      const int i_row = k / 32;
      const double row = (i_row - at) / size;
      const double col = (k % 32 - 16.0) / size;
      switch (i % 7) {
        case 0:
          w(k, 0) = unit;
          break;
        case 1:
          w(k, 0) = unit < 0.02 ? 1.0 : 0.0;
          break;
        case 2:
          w(k, 0) = std::pow(10.0, -6.0 * unit);
          break;
        case 3:
          w(k, 0) = standard_normal(key);
          break;
        case 4:
          w(k, 0) = std::exp(-0.5 * (row * row + col * col));
          break;
        case 5:
          w(k, 0) = i_row < at ? 1.0 : 0.1 * unit;
          break;
        default:
          w(k, 0) = std::pow(unit, 16.0);
          break;
      }
    }
    lights.push_back(std::move(w));
  }
  const std::vector<double> found = ratios(basis(), lights);
  const double worst = *std::max_element(found.begin(), found.end());
  const BasisFile file = basis();
  std::printf("random lights: bound / error median %.3f, worst %.3f; %d vectors in %ju bytes\n",
              median(found), worst, file.tables().coded_bound.n_vectors,
              std::filesystem::file_size(folder_->path() / "a.hlb"));
  EXPECT_LE(median(found), kMedian);
  EXPECT_LE(worst, 2.0);
}

TEST_F(TightBound, HoldsRealSkiesCloseAndNeverBelow) {
  const std::filesystem::path folder = HAARLIGHT_SOURCE_DIR "/../shared/data/envmaps";
  if (!std::filesystem::exists(folder)) {
    GTEST_SKIP() << "no ../shared/data/envmaps here";
  }
  const Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/cube32.toml");
  std::vector<LightWeights> lights;
  for (const char* name : {"apartment.hdr", "studio.exr", "sunset.exr", "venice.hdr"}) {
    for (int turn = 0; turn < 4; ++turn) {
      render::Environment environment = render::Environment::read(folder / name);
      environment.rotate(0.5 * std::numbers::pi * turn);
      lights.push_back(rig_weights(environment, rig).weights);
    }
  }
  // As many more as scripts/fetch_skies has brought.
  if (const char* more = std::getenv("HAARLIGHT_SKIES"); more != nullptr) {
    for (const auto& entry : std::filesystem::directory_iterator(more)) {
      // Lossy compression leaves some negative light, which haarlight refuses.
      Image<float> picture = read_linear_image(entry.path());
      for (float& v : picture.pixels()) {
        v = std::max(v, 0.0F);
      }
      const render::Environment sky =
          render::Environment::from_picture(std::move(picture), entry.path());
      lights.push_back(rig_weights(sky, rig).weights);
    }
    ASSERT_GT(lights.size(), 16U) << more << " is empty";
  }
  std::vector<double> found;
  for (const LightWeights& w : lights) {
    const std::vector<double> one = ratios(basis(), {w});
    found.insert(found.end(), one.begin(), one.end());
  }
  const double worst = *std::max_element(found.begin(), found.end());
  std::printf("%zu real skies: bound / error median %.3f, worst %.3f\n", found.size(),
              median(found), worst);
  EXPECT_LE(median(found), kMedian);
  EXPECT_LE(worst, 2.0);
}

}  // namespace
}  // namespace haarlight::relight
