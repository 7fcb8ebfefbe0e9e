// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/publish_site.h"

#include <filesystem>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "tests/apps/viewer/small_basis.h"

namespace haarlight::apps {
namespace {

class PublishSite : public ::testing::Test {
 protected:
  void SetUp() override {
    (void)test::small_import_basis(folder_.path());
    options_.file = folder_ / "import.hlb";
    options_.out = folder_ / "site";
    options_.web = "web";
  }
  testing::TemporaryFolder folder_;
  PublishSiteOptions options_;
};

TEST_F(PublishSite, KeepsAllLightsOfASmallFile) {
  const PublishSiteSummary summary = publish_site(options_);
  EXPECT_FALSE(summary.is_object);
  EXPECT_EQ(summary.terms, 16);  // direct: one term per light
  EXPECT_TRUE(summary.is_error_kept);
  EXPECT_LE(summary.error, 0.03);  // the file's own is 0.01, the pages' 16 bits besides
  EXPECT_GT(summary.files, 0U);
  EXPECT_TRUE(std::filesystem::exists(folder_ / "site/index.html"));
  EXPECT_EQ(summary.notes.size(), 2U);
}

TEST_F(PublishSite, SaysThatTooSmallAnErrorCannotBePromised) {
  options_.max_error = 1e-9;
  const PublishSiteSummary summary = publish_site(options_);
  EXPECT_FALSE(summary.is_error_kept);
  EXPECT_EQ(summary.notes.back().kind, relight::NoteKind::failure);
}

TEST_F(PublishSite, RefusesOptionsOfTheOtherKindAndWhatStandsThere) {
  options_.quality = 90;
  EXPECT_THROW((void)publish_site(options_), Error);
  options_.quality.reset();
  write_file_atomically(options_.out, "taken");
  EXPECT_THROW((void)publish_site(options_), Error);
}

}  // namespace
}  // namespace haarlight::apps
