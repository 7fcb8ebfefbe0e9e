// SPDX-License-Identifier: Apache-2.0
#include "capture/commission/commission_pipeline.h"

#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "tests/temporary_folder.h"

namespace haarlight::capture {
namespace {

using ::testing::HasSubstr;
using testing::TemporaryFolder;

/// Of a rig whose devices are not there.
class CommissionPipeline : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::string text =
        read_file(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml", 1U << 20U);
    write_file_atomically(folder_ / "rig.toml", text);
    options_.rig = folder_ / "rig.toml";
    options_.fetch = [](const std::string&) { return std::string(); };
    options_.require_consent = [this] { ++requested_; };
    options_.begin = [this] { ++begun_; };
  }
  [[nodiscard]] std::string failure() const {
    try {
      (void)commission_rig(options_);
    } catch (const Error& error) {
      return error.what();
    }
    return "nothing was thrown";
  }

  TemporaryFolder folder_;
  CommissionRigOptions options_;
  int requested_ = 0;
  int begun_ = 0;
};

TEST_F(CommissionPipeline, AsksNobodyWhileADaemonHoldsTheDevices) {
  std::string url;
  options_.fetch = [&url](const std::string& requested) {
    url = requested;
    return std::string("{}");
  };
  EXPECT_THAT(failure(), HasSubstr("a daemon answers at http://127.0.0.1:8481"));
  EXPECT_EQ(url, "http://127.0.0.1:8481/v1/state");
  EXPECT_EQ(requested_, 0);
}

TEST_F(CommissionPipeline, ChecksNamesAndOutputsBeforeItAsks) {
  options_.camera = "nobody";
  EXPECT_THAT(failure(), HasSubstr("no camera \"nobody\""));
  options_.camera.clear();
  write_file_atomically(folder_ / "rig.commission.html", "taken");
  EXPECT_THAT(failure(), HasSubstr("rig.commission.html"));
  EXPECT_EQ(requested_, 0);
}

TEST_F(CommissionPipeline, OpensNothingWithoutConsent) {
  options_.require_consent = [] { throw Error("not begun", "rig", "type yes"); };
  EXPECT_THAT(failure(), HasSubstr("not begun"));
  EXPECT_EQ(begun_, 0);
  options_.require_consent = [this] { ++requested_; };
  EXPECT_THAT(failure(), HasSubstr("connecting the light controller"));
  EXPECT_EQ(requested_, 1);
  EXPECT_EQ(begun_, 1);
  EXPECT_FALSE(std::filesystem::exists(folder_ / "rig.measured.toml"));
}

TEST_F(CommissionPipeline, TellsContradictionsAsWhatStoresNothing) {
  CommissionRigSummary summary;
  summary.page = "page.html";
  EXPECT_TRUE(summary.is_good());
  EXPECT_EQ(commission_text(summary), "page: page.html\n");
  EXPECT_EQ(commission_faults(options_, summary), "");
  summary.result.faults = {"light 3 is dead"};
  EXPECT_FALSE(summary.is_good());
  EXPECT_THAT(commission_faults(options_, summary), HasSubstr("haarlight rig: light 3"));
  summary.result.contradictions = {"shutter"};
  EXPECT_THAT(commission_faults(options_, summary), HasSubstr("nothing was stored"));
}

}  // namespace
}  // namespace haarlight::capture
