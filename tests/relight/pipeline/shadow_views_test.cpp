// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "relight/pipeline/shadow_pipeline.h"
#include "tests/relight/pipeline/captured_box.h"

/// One object on one plane, captured by two cameras that look from opposite sides.

namespace haarlight::relight {
namespace {

using testing::replaced;

const char* const kGround =
    "schema = 1\nname = \"ground\"\n[[material]]\nname = \"m\"\nkd = [0.6]\n"
    "[[box]]\nlow = [-190.0, -190.0, -9.0]\nhigh = [190.0, 190.0, 0.0]\nmaterial = \"m\"\n"
    "[camera]\nsize = [64, 64]\neye = [0.0, -1.0, 900.0]\ntarget = [0.0, 0.0, 0.0]\n"
    "up = [0.0, 1.0, 0.0]\nfov_y_deg = 24\n";
const char* const kPose =
    "[1, 0, 0, 0],\n    [-0, -0.643509750887, 0.765437914212, -560],\n    [0, -0.765437914212, "
    "-0.643509750887, 520]";
/// The same turned about z by 180 degrees.
const char* const kOtherPose =
    "[-1, 0, 0, 0],\n    [0, 0.643509750887, -0.765437914212, 560],\n    [0, -0.765437914212, "
    "-0.643509750887, 520]";

class ShadowViews : public testing::CapturedBox {
 protected:
  void SetUp() override {
    write_file_atomically(folder_ / "ground.toml", kGround);
    capture("one.hlb", rig_);
    options_.captured.basis = folder_ / "one.hlb";
    options_.scene = folder_ / "ground.toml";
    options_.output = folder_ / "shadow.exr";
    options_.light.lights = {"27"};
    options_.truth_object = folder_ / "box.toml";
    options_.truth = folder_ / "truth.exr";
    options_.subpixels = 1;
    options_.method = ShadowMethod::plane;
    options_.settings.overwrites = true;
  }

  ShadowOptions options_;
};

TEST_F(ShadowViews, TheSpreadHoldsTheTruth) {
  options_.method = ShadowMethod::both;
  options_.hull_voxel_mm = 4.0;
  options_.spread = folder_ / "spread.exr";
  options_.unseen = folder_ / "unseen.exr";
  const ShadowSummary found = cast_shadow(options_);
  ASSERT_TRUE(found.truth && found.truth->shadow && found.truth->shadow->spread);
  const ShadowError::Spread& spread = *found.truth->shadow->spread;
  EXPECT_GE(spread.holding_fraction, 0.99);
  EXPECT_GT(found.reprojected.spread_relative, found.reprojected.unseen_relative);
  EXPECT_TRUE(std::filesystem::exists(options_.spread));
  EXPECT_TRUE(std::filesystem::exists(options_.unseen));
  // A truth that stands elsewhere than the object that was captured is not held.
  write_file_atomically(folder_ / "moved.toml",
                        replaced(replaced(testing::kBox, "[-30.0, -30.0", "[30.0, -30.0"),
                                 "[30.0, 30.0", "[90.0, 30.0"));
  options_.truth_object = folder_ / "moved.toml";
  const ShadowSummary moved = cast_shadow(options_);
  ASSERT_TRUE(moved.truth && moved.truth->shadow && moved.truth->shadow->spread);
  EXPECT_LT(moved.truth->shadow->spread->holding_fraction, 0.9);
}

TEST_F(ShadowViews, ASecondCameraShowsWhatTheObjectHidesFromTheFirst) {
  capture("two.hlb", replaced(rig_, kPose, kOtherPose));
  const ShadowSummary one = cast_shadow(options_);
  EXPECT_TRUE(one.joined.empty());
  options_.captured.also = {folder_ / "two.hlb"};
  const ShadowSummary two = cast_shadow(options_);
  EXPECT_EQ(two.n_planes, 1U);
  EXPECT_EQ(two.plates.size(), 2U);
  ASSERT_EQ(two.joined.size(), 1U);
  const JoinedPlane& joined = two.joined[0];
  ASSERT_EQ(joined.known_fractions.size(), 2U);
  EXPECT_EQ(joined.known_fractions[0], one.plates[0].known_fraction);
  // Everything is symmetric in y: the views know equally much (pixels on an edge differ).
  EXPECT_NEAR(joined.known_fractions[0], joined.known_fractions[1], 0.005);
  // Opposite cameras are hidden different parts of the plane behind the box; both lack what lies under it.
  EXPECT_LT(1.0 - joined.known_fraction, 0.5 * (1.0 - joined.known_fractions[0]));
  EXPECT_LT(two.reprojected.unknown_fraction, 0.5 * one.reprojected.unknown_fraction);
  EXPECT_LT(two.truth->shadow->wrong_fraction, 0.5 * one.truth->shadow->wrong_fraction);
  // The hull tells of what is hidden: from one view, by what it has to assume (0.471 wrong), and from
  // both (0.450).
  options_.method = ShadowMethod::both;
  const ShadowSummary two_with_hull = cast_shadow(options_);
  options_.captured.also.clear();
  const ShadowSummary one_with_hull = cast_shadow(options_);
  EXPECT_LT(one_with_hull.truth->shadow->wrong_fraction,
            0.5 * one.truth->shadow->wrong_fraction);
  EXPECT_LT(two_with_hull.truth->shadow->wrong_fraction,
            one_with_hull.truth->shadow->wrong_fraction);
  EXPECT_LT(two_with_hull.truth->shadow->wrong_fraction,
            0.9 * two.truth->shadow->wrong_fraction);
}

TEST_F(ShadowViews, APictureOfTheSamePlaneMayBeSmallerAndCoarser) {
  std::string rig = replaced(rig_, kPose, kOtherPose);
  rig = replaced(rig, "texel = 4.0", "texel = 5.0");
  rig = replaced(rig, "extent = [400.0, 400.0]", "extent = [390.0, 390.0]");
  capture("two.hlb", rig);
  options_.captured.also = {folder_ / "two.hlb"};
  const ShadowSummary summary = cast_shadow(options_);
  EXPECT_EQ(summary.n_planes, 1U);
  EXPECT_EQ(summary.joined.size(), 1U);
}

TEST_F(ShadowViews, APictureThatReachesBeyondIsRefused) {
  capture("two.hlb", replaced(rig_, "extent = [400.0, 400.0]", "extent = [420.0, 400.0]"));
  options_.captured.also = {folder_ / "two.hlb"};
  try {
    (void)cast_shadow(options_);
    FAIL() << "joined";
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("reaches beyond"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("two.hlb"), std::string::npos);
  }
  EXPECT_FALSE(std::filesystem::exists(options_.output));
}

TEST_F(ShadowViews, AMovedPlaneStaysAPlaneOfItsOwn) {
  std::string rig = replaced(rig_, "d = 0.0\norigin = [0.0, 0.0, 0.0]",
                             "d = 50.0\norigin = [0.0, 0.0, -50.0]");
  capture("two.hlb", rig);
  options_.captured.also = {folder_ / "two.hlb"};
  const ShadowSummary summary = cast_shadow(options_);
  EXPECT_EQ(summary.n_planes, 2U);
  EXPECT_TRUE(summary.joined.empty());
}

}  // namespace
}  // namespace haarlight::relight
