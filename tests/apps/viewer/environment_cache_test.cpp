// SPDX-License-Identifier: Apache-2.0
#include "apps/viewer/environment_cache.h"

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <optional>
#include <thread>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "tests/apps/viewer/small_basis.h"

namespace haarlight::apps {
namespace {

using Quality = EnvironmentCache::Quality;

/// A lat-long picture of one coloured sun on a grey sky, as an EXR file's bytes.
std::string sky_bytes(const std::filesystem::path& folder) {
  Image<float> sky(64, 128, 3);
  for (float& v : sky.pixels()) {
    v = 0.1F;
  }
  for (int y = 2; y < 6; ++y) {
    for (int x = 40; x < 60; ++x) {
      sky(y, x, 0) = 50.0F;
      sky(y, x, 1) = 30.0F;
    }
  }
  write_image(folder / "sky.exr", sky.view());
  return read_file(folder / "sky.exr");
}

/// Asks until there is an answer.
relight::EnvironmentWeights wait_for(EnvironmentCache& cache, const std::string& id,
                                     double degrees, Quality quality) {
  for (int i = 0; i < 6000; ++i) {
    if (auto found = cache.weights(id, degrees, quality)) {
      return *found;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  throw std::runtime_error("no weights after a minute");
}

/// A variable of the environment that has its old value again at the end.
class TemporaryVariable {
 public:
  TemporaryVariable(const char* name, const std::string& value) : name_(name) {
    if (const char* old = std::getenv(name)) {
      old_ = old;
    }
    ::setenv(name, value.c_str(), 1);
  }
  ~TemporaryVariable() {
    if (old_) {
      ::setenv(name_, old_->c_str(), 1);
    } else {
      ::unsetenv(name_);
    }
  }
  TemporaryVariable(const TemporaryVariable&) = delete;
  TemporaryVariable& operator=(const TemporaryVariable&) = delete;

 private:
  const char* name_;
  std::optional<std::string> old_;
};

class EnvironmentCacheTest : public ::testing::Test {
 protected:
  testing::TemporaryFolder folder_;
  relight::BasisFile basis_ = test::small_rig_basis(folder_.path());
};

TEST_F(EnvironmentCacheTest, ExactWeightsAreThoseOfTheCommand) {
  EnvironmentCache cache(basis_);
  const std::string id = cache.add(sky_bytes(folder_.path()), "sky.exr");
  for (const double degrees : {0.0, 37.5, -120.0}) {
    render::Environment truth = render::Environment::read(folder_.path() / "sky.exr");
    truth.rotate(degrees * std::numbers::pi / 180.0);
    const relight::EnvironmentWeights expected =
        relight::rig_weights(truth, parse_rig(basis_.header().rig_toml, "rig"));
    const relight::EnvironmentWeights found = wait_for(cache, id, degrees, Quality::exact);
    EXPECT_EQ(found.weights, expected.weights) << degrees;
    EXPECT_EQ(found.missing_fraction, expected.missing_fraction);
  }
  EXPECT_EQ(cache.layout(id), "lat-long");
}

TEST_F(EnvironmentCacheTest, QuickWeightsAreThoseOfTheReducedPicture) {
  EnvironmentCache cache(basis_);
  const std::string id = cache.add(sky_bytes(folder_.path()), "sky.exr");
  const relight::EnvironmentWeights exact = wait_for(cache, id, 10.0, Quality::exact);
  const relight::EnvironmentWeights quick = wait_for(cache, id, 10.0, Quality::quick);
  // 128 texels all the way round are few enough: nothing is reduced.
  EXPECT_EQ(quick.weights, exact.weights);
}

TEST_F(EnvironmentCacheTest, SaysWhatIsWrongWithAPicture) {
  EnvironmentCache cache(basis_);
  const std::string id = cache.add("no picture at all", "holiday.hdr");
  try {
    (void)wait_for(cache, id, 0.0, Quality::exact);
    FAIL() << "a broken picture must be refused";
  } catch (const Error& error) {
    EXPECT_NE(error.where().find("holiday.hdr"), std::string::npos) << error.what();
    EXPECT_EQ(std::string(error.what()).find("haarlight-view-"), std::string::npos)
        << "the temporary file's name is nobody's concern";
    EXPECT_FALSE(error.hint().empty());
  }
  EXPECT_THROW((void)cache.weights(id, 0.0, Quality::quick), Error) << "it is remembered";
}

TEST_F(EnvironmentCacheTest, KeepsTheLastEnvironmentsOnly) {
  EnvironmentCache cache(basis_);
  const std::string bytes = sky_bytes(folder_.path());
  const std::string first = cache.add(bytes, "sky.exr");
  std::string last = first;
  for (std::size_t i = 0; i < EnvironmentCache::kMostKept; ++i) {
    last = cache.add(bytes, "sky.exr");
  }
  EXPECT_THROW((void)cache.weights(first, 0.0, Quality::exact), Error);
  EXPECT_GT(wait_for(cache, last, 0.0, Quality::exact).weights.sum(), 0.0);
  EXPECT_THROW((void)cache.weights("7000", 0.0, Quality::exact), Error);
  EXPECT_THROW((void)cache.weights("../sky", 0.0, Quality::exact), Error);
}

TEST_F(EnvironmentCacheTest, EndsWhileItIsAtWorkAndLeavesNothing) {
  const std::filesystem::path temporary = folder_ / "tmp";
  std::filesystem::create_directory(temporary);
  const std::string bytes = sky_bytes(folder_.path());
  const TemporaryVariable variable("TMPDIR", temporary.string());
  for (int i = 0; i < 3; ++i) {
    EnvironmentCache cache(basis_);
    const std::string id = cache.add(bytes, "sky.exr");
    EXPECT_FALSE(cache.weights(id, 1.0, Quality::exact).has_value()) << "it is at work";
  }
  EXPECT_TRUE(std::filesystem::is_empty(temporary));
}

TEST(CacheOfAnImport, SharesTheSkyAmongTheLightsDirections) {
  testing::TemporaryFolder folder;
  const relight::BasisFile basis = test::small_import_basis(folder.path());
  EnvironmentCache cache(basis);
  const std::string id = cache.add(sky_bytes(folder.path()), "sky.exr");
  const relight::EnvironmentWeights found = wait_for(cache, id, 0.0, Quality::exact);
  EXPECT_EQ(found.weights.rows(), basis.header().dims.n_lights);
  EXPECT_NEAR(found.weights.col(0).sum(), found.total.x(), 1e-6 * found.total.x());
}

}  // namespace
}  // namespace haarlight::apps
