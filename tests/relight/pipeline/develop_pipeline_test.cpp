// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/develop_pipeline.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/pipeline/ramp_session.h"

namespace haarlight::relight {
namespace {

using testing::RampSession;
using testing::TemporaryFolder;

TEST(DevelopPipeline, WritesAPictureForEachLight) {
  const TemporaryFolder folder;
  RampSession{}.write(folder / "ramp.session");
  DevelopSessionOptions options;
  options.session = folder / "ramp.session";
  options.exr = folder / "exr";
  const DevelopSummary summary = develop_session(options);
  EXPECT_EQ(summary.dims.n_lights, 5);
  EXPECT_EQ(summary.dims.width, 8);
  EXPECT_EQ(summary.n_saturated, 0U);
  EXPECT_EQ(summary.moved_fraction, 0.0);
  EXPECT_EQ(summary.cache, (folder / "ramp.session/cache").string());
  std::uintmax_t bytes = sizeof(float) * 8 * 6 * 5;
  for (int k = 0; k < 5; ++k) {
    const std::filesystem::path file = folder / fmt::format("exr/light_{:04}.exr", k);
    bytes += std::filesystem::file_size(file);
    const Image<float> picture = read_linear_image(file);
    // Linear floats at unit power stay what they are.
    EXPECT_FLOAT_EQ(picture(2, 3), static_cast<float>(RampSession::value(2, 3, k)));
  }
  EXPECT_EQ(summary.bytes, bytes);
  EXPECT_EQ(summary.notes.size(), 2U);
  EXPECT_THROW((void)develop_session(options), Error);  // the folder exists
}

}  // namespace
}  // namespace haarlight::relight
