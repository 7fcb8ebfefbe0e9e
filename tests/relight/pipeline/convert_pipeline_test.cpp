// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/convert_pipeline.h"

#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

using testing::TemporaryFolder;

constexpr int kWidth = 6;
constexpr int kHeight = 4;

/// A .ptm that is equally bright from everywhere: luminance 128 of 255, colour 200.
std::string even_ptm() {
  std::string text = "PTM_1.2\nPTM_FORMAT_LRGB\n6\n4\n1 1 1 1 1 1\n0 0 0 0 0 0\n";
  for (int i = 0; i < kWidth * kHeight; ++i) {
    text += std::string(5, '\0') + static_cast<char>(128);
  }
  return text + std::string(std::size_t{3} * kWidth * kHeight, static_cast<char>(200));
}

ConvertOptions even_options(const TemporaryFolder& folder, const char* output) {
  write_file_atomically(folder / "even.ptm", even_ptm());
  ConvertOptions options;
  options.input = folder / "even.ptm";
  options.output = folder / output;
  return options;
}

TEST(ConvertPipeline, WritesTheSamePicturesInTheSameFormat) {
  const TemporaryFolder folder;
  const ConvertSummary summary = convert_reflectance(even_options(folder, "again.ptm"));
  EXPECT_EQ(summary.kind, ConvertedKind::model);
  EXPECT_FALSE(summary.is_refitted);
  EXPECT_TRUE(summary.difference.is_same);
  EXPECT_EQ(summary.basis, ReflectanceBasis::ptm);
  EXPECT_EQ(summary.n_terms, 6);
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(folder / "again.ptm"));
}

TEST(ConvertPipeline, RefitsAConstantWithoutLoss) {
  const TemporaryFolder folder;
  const ConvertSummary summary = convert_reflectance(even_options(folder, "even.rti"));
  EXPECT_TRUE(summary.is_refitted);
  EXPECT_EQ(summary.basis, ReflectanceBasis::hsh);
  EXPECT_TRUE(summary.difference.is_same || summary.difference.worst_db > 50.0);
}

TEST(ConvertPipeline, LightsOnePicture) {
  const TemporaryFolder folder;
  ConvertOptions options = even_options(folder, "lit.png");
  options.light = Eigen::Vector3d(0.5, 0.0, 2.0);
  const ConvertSummary summary = convert_reflectance(options);
  EXPECT_EQ(summary.kind, ConvertedKind::picture);
  const Image<float> picture = read_linear_image(options.output);
  ASSERT_EQ(picture.width(), kWidth);
  // 128 * 200/255 = 100.4, a byte of the picture.
  EXPECT_NEAR(picture(1, 2), linear_from_srgb(100.0F / 255.0F), 1e-6);
  options.light = Eigen::Vector3d::Zero();
  options.settings.overwrites = true;
  EXPECT_THROW((void)convert_reflectance(options), Error);
}

TEST(ConvertPipeline, CountsTheLightsOfAList) {
  const TemporaryFolder folder;
  write_file_atomically(folder / "three.lp", "3\na.png 0 0 1\nb.png 1 0 1\nc.png 0 1 1\n");
  ConvertOptions options;
  options.input = folder / "three.lp";
  options.output = folder / "three.dome";
  const ConvertSummary summary = convert_reflectance(options);
  EXPECT_EQ(summary.kind, ConvertedKind::lights);
  EXPECT_EQ(summary.n_lights, 3U);
  EXPECT_EQ(summary.bytes, std::filesystem::file_size(options.output));
}

TEST(ConvertPipeline, RefusesWhatAFormatCannotHold) {
  const TemporaryFolder folder;
  ConvertOptions options = even_options(folder, "jpeg.rti");
  options.is_jpeg = true;
  EXPECT_THROW((void)convert_reflectance(options), Error);
  options.is_jpeg = false;
  options.terms = 5;
  EXPECT_THROW((void)convert_reflectance(options), Error);
  EXPECT_FALSE(std::filesystem::exists(options.output));
}

}  // namespace
}  // namespace haarlight::relight
