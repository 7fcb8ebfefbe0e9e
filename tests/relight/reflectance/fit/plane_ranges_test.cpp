// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/fit/plane_ranges.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"
#include "relight/reflectance/fit/plane_store.h"
#include "relight/reflectance/fit/transfer_table.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

/// Codes between 20000 and 40000, a hundred of each, and two that are far away.
PlaneHistogram histogram_with_outliers() {
  std::vector<std::uint16_t> codes(20000);
  std::iota(codes.begin(), codes.end(), std::uint16_t{20000});
  PlaneHistogram histogram;
  for (int i = 0; i < 100; ++i) {
    histogram.add(codes);
  }
  histogram.add(std::vector<std::uint16_t>(2, 65535));
  return histogram;
}

double error_of(const PlaneScale& scale, double value) {
  const double byte = std::clamp(std::round((value - scale.offset) / scale.scale), 0.0, 255.0);
  return byte * scale.scale + scale.offset - value;
}

TEST(PlaneRanges, CutsOffOutliersWhereThatLosesLess) {
  const PlaneCodes codes{0.0, 1.0 / 65535.0};
  const PlaneHistogram histogram = histogram_with_outliers();
  const PlaneRange cut = choose_range(histogram, codes, RangeEnds::least_error);
  const PlaneRange whole = choose_range(histogram, codes, RangeEnds::extremes);
  EXPECT_EQ(whole.clipped, 0.0);
  EXPECT_NEAR(whole.scale.offset + 255.0 * whole.scale.scale, 1.0, 1e-9);
  EXPECT_LT(cut.rms_error, 0.8 * whole.rms_error);
  // What it says of its error is what it is.
  double sum = 0.0;
  for (int i = 20000; i < 40000; ++i) {
    sum += std::pow(error_of(cut.scale, i / 65535.0), 2);
  }
  sum = 100.0 * sum + 2.0 * std::pow(error_of(cut.scale, 1.0), 2);
  EXPECT_NEAR(cut.rms_error, std::sqrt(sum / 2000002.0), 0.1 * cut.rms_error);
}

TEST(PlaneRanges, ObeyTheRulesOfFiles) {
  const PlaneCodes codes{-0.3, 1.0 / 65535.0};
  for (const ScaleRule rule : {ScaleRule::ptm, ScaleRule::rti}) {
    ReflectanceModel model;
    model.basis = rule == ScaleRule::ptm ? ReflectanceBasis::ptm : ReflectanceBasis::hsh;
    model.n_terms = rule == ScaleRule::ptm ? 6 : 9;
    const PlaneRange range =
        choose_range(histogram_with_outliers(), codes, RangeEnds::extremes, rule);
    const int n_planes = 3 * model.n_terms;
    model.scales.assign(static_cast<std::size_t>(n_planes), range.scale);
    model.planes = Image<std::uint8_t>(1, 1, n_planes);
    EXPECT_TRUE(obeys(rule, model));
    // Both ends are within reach.
    EXPECT_LE(range.scale.offset, -0.3 + 20000.0 / 65535.0 + 1e-6);
    EXPECT_GE(range.scale.offset + 255.0 * range.scale.scale, 0.7 - 1e-6);
  }
}

TEST(PlaneRanges, AConstantPlaneHasAScale) {
  PlaneHistogram histogram;
  histogram.add(std::vector<std::uint16_t>(100, 30000));
  for (const ScaleRule rule : {ScaleRule::any, ScaleRule::ptm, ScaleRule::rti}) {
    const PlaneRange range =
        choose_range(histogram, {0.0, 1.0 / 65535.0}, RangeEnds::least_error, rule);
    EXPECT_GT(range.scale.scale, 0.0);
    EXPECT_LT(std::abs(error_of(range.scale, 30000.0 / 65535.0)), 0.51 * range.scale.scale);
  }
}

TEST(PlaneStore, GivesBackWhatItGotFromMemoryAndFromDisk) {
  const testing::TemporaryFolder folder;
  std::vector<std::uint16_t> values(100000);
  for (std::size_t i = 0; i < values.size(); ++i) {
    values[i] = static_cast<std::uint16_t>(i * 40503U);
  }
  for (const std::uint64_t memory : {std::uint64_t{1} << 20U, std::uint64_t{0}}) {
    PlaneStore store(values.size(), memory, folder.path());
    EXPECT_EQ(store.is_on_disk(), memory == 0);
    std::copy_n(values.begin(), 30000, store.room(30000).begin());
    store.keep();
    std::copy_n(values.begin() + 30000, 70000, store.room(70000).begin());
    store.keep();
    EXPECT_EQ(store.next(1)[0], values[0]);
    const auto rest = store.next(values.size() - 1);
    EXPECT_TRUE(std::equal(rest.begin(), rest.end(), values.begin() + 1));
  }
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
  EXPECT_THROW(PlaneStore(1, 0, folder / "missing"), Error);
}

TEST(TransferTable, IsTheCurve) {
  const TransferTable table(Transfer::srgb);
  for (int i = -10; i <= 60000; ++i) {
    const float linear = static_cast<float>(i) / 20000.0F;
    EXPECT_NEAR(table(linear), i < 0 ? 0.0F : srgb_from_linear(linear), 2e-5F);
  }
  EXPECT_NEAR(table(9.0F), srgb_from_linear(4.0F), 1e-4F);
}

}  // namespace
}  // namespace haarlight::relight
