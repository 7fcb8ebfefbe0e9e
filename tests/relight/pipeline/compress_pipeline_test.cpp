// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/compress_pipeline.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/relight/pipeline/ramp_session.h"

namespace haarlight::relight {
namespace {

using testing::RampSession;
using testing::TemporaryFolder;

CompressCaptureOptions ramp_options(const TemporaryFolder& folder) {
  RampSession{}.write(folder / "ramp.session");
  CompressCaptureOptions options;
  options.session = folder / "ramp.session";
  options.output = folder / "ramp.hlb";
  options.plate = "none";
  return options;
}

TEST(CompressPipeline, KeepsEveryFloatWhereNoErrorIsAllowed) {
  const TemporaryFolder folder;
  CompressCaptureOptions options = ramp_options(folder);
  options.basis = BasisKind::direct;
  options.max_error = 0.0;
  const CompressCaptureSummary summary = compress_capture(options);
  const BasisHeader& header = summary.compressed.header;
  EXPECT_EQ(header.dims.width, 8);
  EXPECT_EQ(header.dims.height, 6);
  EXPECT_EQ(header.dims.n_lights, 5);
  EXPECT_EQ(header.achieved.relative_l2, 0.0);
  EXPECT_EQ(summary.relative_l2_requested, 0.0);
  EXPECT_EQ(summary.request_reason, "as requested");
  EXPECT_FALSE(summary.noise);
  EXPECT_EQ(summary.compressed.bytes, std::filesystem::file_size(options.output));
  ASSERT_EQ(summary.notes.size(), 1U);
  EXPECT_EQ(summary.notes[0].kind, NoteKind::result);
}

TEST(CompressPipeline, TellsWhatItChoseForLightsWithoutGridsAndNoise) {
  const TemporaryFolder folder;
  CompressCaptureOptions options = ramp_options(folder);
  std::vector<PipelineNote> told;
  options.settings.tell = [&told](const PipelineNote& note) { told.push_back(note); };
  const CompressCaptureSummary summary = compress_capture(options);
  EXPECT_EQ(summary.compressed.header.basis, BasisKind::direct);
  EXPECT_EQ(summary.relative_l2_requested, 0.01);  // floats of a file: nobody measured noise
  EXPECT_LE(summary.compressed.header.achieved.relative_l2, 0.01);
  EXPECT_EQ(told, summary.notes);
  ASSERT_EQ(told.size(), 2U);
  EXPECT_EQ(told[0].kind, NoteKind::warning);
}

TEST(CompressPipeline, RefusesHaarWithoutGridsAndAnOutputThatExists) {
  const TemporaryFolder folder;
  CompressCaptureOptions options = ramp_options(folder);
  options.basis = BasisKind::haar;
  EXPECT_THROW((void)compress_capture(options), Error);
  options.basis = BasisKind::direct;
  write_file_atomically(options.output, "taken");
  EXPECT_THROW((void)compress_capture(options), Error);
}

}  // namespace
}  // namespace haarlight::relight
