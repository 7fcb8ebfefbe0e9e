// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <numbers>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "core/random.h"
#include "haarlight/core/error.h"
#include "relight/pipeline/hull_pipeline.h"
#include "tests/relight/pipeline/captured_box.h"

/// Captures that strain a shadow hull: a stated result or a clear error for each.

namespace haarlight::relight {
namespace {

constexpr double kMm3 = 60.0 * 60.0 * 60.0;  // of the box

class HullExtremes : public testing::CapturedBox {
 protected:
  HullExtremes() {
    options_.captured.basis = folder_ / "box.hlb";
    options_.voxel_mm = 5.0;
    options_.outputs = {folder_ / "box.vtu"};
    options_.settings.overwrites = true;
  }

  /// Square, `half` mm to each side of the origin.
  void put_box(double low, double high, double half = 30.0) const {
    write_file_atomically(
        folder_ / "box.toml",
        fmt::format("schema = 1\nname = \"box\"\n[[material]]\nname = \"m\"\nkd = [0.3]\n"
                    "[[box]]\nlow = [{0}, {0}, {1}]\nhigh = [{2}, {2}, {3}]\nmaterial = "
                    "\"m\"\n",
                    -half, low, half, high));
  }

  [[nodiscard]] HullPipelineSummary hull_of(const std::string& rig_toml,
                                            const MemoryStack& stack,
                                            HaarGrid grid = {8, 8}) const {
    store("box.hlb", rig_toml, stack, grid);
    return export_hull(options_);
  }

  [[nodiscard]] static std::string told(const HullPipelineSummary& summary) {
    std::string text;
    for (const PipelineNote& note : summary.notes) {
      text += note.text + "\n";
    }
    return text;
  }

  HullPipelineOptions options_;
};

TEST_F(HullExtremes, AnObjectLargerThanThePictureIsCutAtItsBorder) {
  put_box(20.0, 60.0, 230.0);
  const HullPipelineSummary found = hull_of(rig_, render(rig_));
  EXPECT_TRUE(found.source.hull.touches_border);
  EXPECT_NE(told(found).find("reaches the border of the plane's picture"), std::string::npos);
  // Nothing of it is certain: half of the lights saw no point under it.
  EXPECT_EQ(found.source.hull.n_matter, 0);
  EXPECT_GT(found.source.hull.n_assumed_full, 0);
}

TEST_F(HullExtremes, AnObjectOnThePlaneIsSolid) {
  put_box(0.0, 60.0);
  const HullPipelineSummary found = hull_of(rig_, render(rig_));
  EXPECT_NEAR(found.volume_mm3 / kMm3, 1.0, 0.3);
  EXPECT_EQ(found.source.hull.low_mm, 0.0);
  EXPECT_FALSE(found.source.hull.touches_border);
  EXPECT_FALSE(found.source.hull.leaves_camera);
}

TEST_F(HullExtremes, AnObjectAsHighAsTheLightsIsCutByTheCamera) {
  for (const double high : {890.0, 1200.0}) {
    put_box(20.0, high);
    const HullPipelineSummary found = hull_of(rig_, render(rig_));
    EXPECT_TRUE(found.source.hull.leaves_camera) << high;
    EXPECT_NE(told(found).find("the border of the camera's picture cuts the object"),
              std::string::npos);
    EXPECT_GT(found.source.hull.high_mm, 150.0) << high;
  }
}

TEST_F(HullExtremes, ADarkCaptureIsRefused) {
  put_box(20.0, 80.0);
  try {
    (void)hull_of(rig_, MemoryStack(render(rig_).dims()));
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("black"), std::string::npos) << error.what();
  }
}

TEST_F(HullExtremes, ATransparentObjectIsSmallerTheMoreLightItPasses) {
  put_box(20.0, 80.0);
  const MemoryStack opaque = render(rig_);
  put_box(9000.0, 9001.0);
  const MemoryStack none = render(rig_);
  double last = hull_of(rig_, opaque).volume_mm3;
  for (const float passes : {0.3F, 0.7F}) {
    std::vector<float> mixed;
    std::ranges::transform(
        opaque.values(), none.values(), std::back_inserter(mixed),
        [passes](float dark, float lit) { return (1.0F - passes) * dark + passes * lit; });
    const double volume = hull_of(rig_, MemoryStack(opaque.dims(), mixed)).volume_mm3;
    EXPECT_LT(volume, last) << passes;
    last = volume;
  }
  // V = 0.7 is carved wherever lights saw; what is left was hidden from them.
  EXPECT_LT(last, 0.8 * kMm3);
}

TEST_F(HullExtremes, FewerThanFourLightsAreRefused) {
  put_box(20.0, 80.0);
  std::string rig = testing::replaced(rig_, "rows = 8", "rows = 1");
  rig = testing::replaced(rig, "cols = 8", "cols = 1");
  try {
    (void)hull_of(rig, render(rig), {1, 1});
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("1 light shines on the shadow plane: too few"),
              std::string::npos)
        << error.what();
    EXPECT_NE(std::string(error.what()).find("at least 4 lights"), std::string::npos);
  }
  EXPECT_FALSE(std::filesystem::exists(folder_ / "box.vtu"));
}

TEST_F(HullExtremes, AHandInThreeFramesChangesNothing) {
  put_box(20.0, 80.0);
  MemoryStack stack = render(rig_);
  const double undisturbed = hull_of(rig_, stack).volume_mm3;
  const StackDims dims = stack.dims();
  for (int y = 0; y < dims.height; ++y) {
    for (int x = 0; x < dims.width / 2; ++x) {
      for (const int k : {9, 27, 50}) {
        stack.at(0, y, x, k) *= 0.05F;
      }
    }
  }
  EXPECT_NEAR(hull_of(rig_, stack).volume_mm3 / undisturbed, 1.0, 0.02);
}

/// The rig with its plane higher than it is, and turned about y.
std::string misplaced(std::string rig, double off_mm, double tilt_deg = 0.0) {
  const double angle = tilt_deg * std::numbers::pi / 180.0;
  rig = testing::replaced(
      rig, "n = [0.0, 0.0, 1.0]\nd = 0.0\norigin = [0.0, 0.0, 0.0]\nu = [1.0, 0.0, 0.0]",
      fmt::format("n = [{0:.12f}, 0.0, {1:.12f}]\nd = {2:.12f}\norigin = [0.0, 0.0, "
                  "{3:.12f}]\nu = [{1:.12f}, 0.0, {4:.12f}]",
                  std::sin(angle), std::cos(angle), -off_mm * std::cos(angle), off_mm,
                  -std::sin(angle)));
  return rig;
}

TEST_F(HullExtremes, APlaneThatIsOffByAMillimetreOrADegreeChangesLittle) {
  put_box(20.0, 80.0);
  const MemoryStack stack = render(rig_);
  const double right = hull_of(rig_, stack).volume_mm3;
  for (const double off : {-1.0, 1.0}) {
    const HullPipelineSummary found = hull_of(misplaced(rig_, off), stack);
    EXPECT_NEAR(found.volume_mm3 / right, 1.0, 0.05) << off << " mm";
    EXPECT_NEAR(found.source.hull.offset.mm, -off, 0.1);
  }
  const HullPipelineSummary tilted = hull_of(misplaced(rig_, 0.0, 1.0), stack);
  EXPECT_NEAR(tilted.volume_mm3 / right, 1.0, 0.1);
  EXPECT_NEAR(tilted.source.hull.offset.tilt_deg, 1.0, 0.05);
}

TEST_F(HullExtremes, APlaneOrALobeThatIsNotTheRigFilesIsTold) {
  put_box(20.0, 80.0);
  const MemoryStack stack = render(rig_);
  const std::string words = "does not fit the rig file";
  const HullPipelineSummary right = hull_of(rig_, stack);
  EXPECT_FALSE(right.source.hull.offset.is_noticeable);
  EXPECT_LT(right.source.hull.offset.most_mm, 0.2);
  EXPECT_EQ(told(right).find(words), std::string::npos);
  // First order in the height: a tenth of it at 60 mm under lights at 900.
  for (const double off : {-30.0, -5.0, 18.0, 60.0}) {
    const HullPipelineSummary found = hull_of(misplaced(rig_, off), stack);
    EXPECT_NEAR(found.source.hull.offset.mm, -off, 0.1 + 0.1 * std::abs(off));
    EXPECT_NE(told(found).find(words), std::string::npos) << off;
    const HullPipelineSummary kept = export_hull(options_);
    EXPECT_FALSE(kept.source.is_carved);
    EXPECT_NE(told(kept).find(words), std::string::npos) << off;
  }
  const HullPipelineSummary tilted = hull_of(misplaced(rig_, 0.0, 5.0), stack);
  EXPECT_NEAR(tilted.source.hull.offset.tilt_deg, 5.0, 0.5);
  EXPECT_NE(told(tilted).find(words), std::string::npos);
  // LEDs of unequal power say less, and do not look like another plane.
  MemoryStack unequal = stack;
  for (int k = 0; k < stack.dims().n_lights; ++k) {
    const double power =
        1.0 + 0.1 * standard_normal(hash_key(8, static_cast<std::uint64_t>(k)));
    for (int y = 0; y < stack.dims().height; ++y) {
      for (int x = 0; x < stack.dims().width; ++x) {
        unequal.at(0, y, x, k) *= static_cast<float>(power);
      }
    }
  }
  EXPECT_EQ(told(hull_of(rig_, unequal)).find(words), std::string::npos);
  // A narrower lobe than the LEDs' looks like another plane.
  const std::string narrow = testing::replaced(rig_, "lobe_mu = 1.0", "lobe_mu = 1.3");
  EXPECT_NE(told(hull_of(narrow, stack)).find(words), std::string::npos);
}

}  // namespace
}  // namespace haarlight::relight
