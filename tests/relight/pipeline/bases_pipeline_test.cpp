// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/bases_pipeline.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/pipeline/ramp_session.h"

namespace haarlight::relight {
namespace {

using testing::RampSession;
using testing::TemporaryFolder;

TEST(BasesPipeline, FindsThatACaptureOfRankOneIsOneVector) {
  const TemporaryFolder folder;
  RampSession{}.write(folder / "ramp.session");
  BasesOptions options;
  options.input = folder / "ramp.session";
  options.output = folder / "bases";
  options.bases = {"pca"};
  options.errors = {0.01};
  options.sizes = {1.0};
  options.plate = "none";
  const BasesSummary summary = compare_bases(options);
  EXPECT_TRUE(summary.is_achieved);
  EXPECT_EQ(summary.plate_origin, PlateOrigin::none);
  EXPECT_EQ(summary.study.n_pixels, 48);
  ASSERT_EQ(summary.study.results.size(), 1U);
  for (const BasisPoint& point : summary.study.results[0].points) {
    if (point.kind == PointKind::error) {
      EXPECT_NEAR(point.stack_error[0], 0.01, 5e-4);  // the step comes from a histogram
      EXPECT_EQ(point.n_patterns, 1);
    }
  }
  for (const char* name : {"bases.txt", "bases.json", "records.json", "regions.png"}) {
    EXPECT_TRUE(std::filesystem::exists(folder / "bases" / name)) << name;
  }
  EXPECT_GT(summary.bytes, 0U);
  EXPECT_THROW((void)compare_bases(options), Error);  // the output exists
}

}  // namespace
}  // namespace haarlight::relight
