// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/compress_session.h"

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/rig/rig.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/relight.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/plate/plate.h"
#include "tests/session/small_session.h"

namespace haarlight::relight {
namespace {

using test::TemporaryFolder;

/// small8's rig with as many lights as the grid says.
Rig small_rig() { return read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml"); }

TEST(ComputedPlate, IsLambertOnThePlaneAndNothingInTheSky) {
  Rig rig = small_rig();
  CameraModel& camera = rig.cameras.front().model;
  // Straight down from 300 mm: the middle pixel sees the origin.
  camera.world_from_cam = look_at({0, 0, 300}, {0, 0, 0}, {0, 1, 0});
  const ComputedPlate plate(rig);
  ASSERT_EQ(plate.dims(), (StackDims{64, 48, 1, 64}));
  std::vector<float> row(64);
  plate.read_tile({31, 23, 1, 1}, row);
  for (int k = 0; k < 64; ++k) {
    const LightElement light = light_element(rig, k);
    // A square of area A far away: A cos^2 / (pi r^2).
    const double r2 = light.centre.squaredNorm();
    const double cosine = light.centre.z() / std::sqrt(r2);
    const double point = 112.0 * 112.0 * cosine * cosine / (3.14159265358979 * r2);
    EXPECT_NEAR(row[static_cast<std::size_t>(k)] / point, 1.0, 0.02) << k;
  }
  camera.world_from_cam = look_at({0, 0, 300}, {0, 0, 600}, {0, 1, 0});
  ComputedPlate(rig).read_tile({31, 23, 1, 1}, row);
  EXPECT_THAT(row, testing::Each(0.0F));
}

TEST(ComputedPlate, NeedsLightOnThePlane) {
  Rig rig = small_rig();
  rig.faces.front().emits = -rig.faces.front().emits;
  EXPECT_THROW(ComputedPlate{rig}, Error);
}

TEST(ComputedPlate, NeedsACameraAndAPlane) {
  Rig rig = small_rig();
  rig.planes.clear();
  EXPECT_THROW(ComputedPlate{rig}, Error);
}

TEST(PlateGain, IsRobustAndLeavesOutTheDark) {
  const std::vector<float> b = {4.0F, 3.0F, 2.0F, 1.0F, 0.0F};
  EXPECT_FLOAT_EQ(plate_gain(std::vector<float>{2.0F, 1.5F, 1.0F, 0.0F, 7e-4F}, b), 0.5F);
  EXPECT_EQ(
      plate_gain(std::vector<float>{0.5F, 1.0F, 1.5F, 0.0F, 9.0F}, std::vector<float>(5, 0.0F)),
      0.0F);
  // A gain that would make it worse is not taken.
  EXPECT_EQ(plate_gain(std::vector<float>{9.0F, 0.2F, 3.0F, 0.0F, 0.0F},
                       std::vector<float>{0.1F, 0.1F, 1.0F, 0.1F, 9.0F}),
            0.0F);
}

TEST(PlateVectors, FewVectorsCarryAPlate) {
  const ComputedPlate plate(small_rig());
  const PlateVectors percent = fit_plate_vectors(plate, 0.01);
  EXPECT_LE(percent.rank, 8);  // the plate has a rank of about 6 at 1 %
  EXPECT_LE(percent.missed, 0.01);
  EXPECT_GT(fit_plate_vectors(plate, 1e-4).rank, percent.rank);
  for (int i = 0; i < percent.rank; ++i) {
    for (int j = 0; j <= i; ++j) {
      double product = 0.0;
      const auto row = [&](int r) { return percent.vectors.begin() + r * std::ptrdiff_t{64}; };
      for (int k = 0; k < 64; ++k) {
        product += double{row(i)[k]} * double{row(j)[k]};
      }
      EXPECT_NEAR(product, i == j ? 1.0 : 0.0, 1e-6);
    }
  }
}

TEST(CompressPlate, RigsPlateIsAFileThatGivesThePlateBack) {
  const TemporaryFolder folder;
  const Rig rig = small_rig();
  const auto file = folder.path() / "plate.hlb";
  const CompressSummary summary = compress_plate(rig, file, {.relative_l2 = 1e-4});
  EXPECT_TRUE(summary.is_achieved());
  const BasisFile basis = BasisFile::open(file);
  EXPECT_EQ(basis.header().content, BasisContent::plate);
  EXPECT_EQ(basis.header().grid, (HaarGrid{8, 8}));
  EXPECT_EQ(basis.header().rig_hash, rig.hash);
  EXPECT_EQ(parse_rig(basis.header().rig_toml, "x").n_lights(), 64);
  const MemoryStack plate = read_all(ComputedPlate(rig));
  const MemoryStack decoded = read_all(BasisSource(basis));
  EXPECT_LE(compare(decoded.values(), plate.values()).relative_l2, 1e-4 + 1e-7);
}

TEST(CompressSession, SessionBecomesABasisFileThatKnowsItsLights) {
  const TemporaryFolder folder;
  const auto session_folder = folder.path() / "session";
  session::SessionInfo info = test::small_info(16);
  info.grid_rows = info.grid_cols = 4;
  test::make_session(session_folder, info, test::small_pixels);
  const session::Session session = session::Session::open(session_folder);
  const auto file = folder.path() / "a.hlb";
  const CompressSummary summary =
      compress_session(session, PlateChoice::parse("none"), file, {.relative_l2 = 0.0});
  EXPECT_EQ(summary.header.grid, haar_grid(session.info()));
  EXPECT_EQ(summary.header.coding, BasisCoding::integers) << "whole steps of the camera";
  EXPECT_EQ(summary.header.achieved.worst_value, 0.0);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 2);
  const BasisFile basis = BasisFile::open(file);
  const LightStack stack = session::develop(session);
  LightWeights w = LightWeights::Zero(16, 1);
  w(3, 0) = 0.5;
  w(9, 0) = 2.0;
  EXPECT_EQ(
      compare(relight(basis, w).picture.pixels(), relight_stack(stack, w).pixels()).worst_pixel,
      0.0);
  EXPECT_TRUE(!basis.header().rig_toml.empty() || basis.header().lights.size() == 16U);
}

TEST(CompressSession, NoiseThatNobodyMeasuredIsNotGuessed) {
  const TemporaryFolder folder;
  test::make_small_session(folder.path() / "s", 4);
  EXPECT_FALSE(
      measure_noise(session::Session::open(folder.path() / "s"), PlateChoice::parse("none"), {})
          .has_value());
}

TEST(CompressSession, PlateMustBeAFileAFolderOrNone) {
  EXPECT_EQ(PlateChoice::parse("").kind, PlateChoice::Kind::automatic);
  EXPECT_EQ(PlateChoice::parse("none").kind, PlateChoice::Kind::none);
  EXPECT_THROW((void)PlateChoice::parse("/no/such/plate.hlb"), Error);
}

}  // namespace
}  // namespace haarlight::relight
