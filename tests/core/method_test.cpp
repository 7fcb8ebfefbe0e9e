// SPDX-License-Identifier: Apache-2.0
#include "core/method.h"

#include <cmath>
#include <limits>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "core/method_run.h"
#include "haarlight/core/error.h"

namespace haarlight {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// pi by as many terms of an alternating series as the setting says.
template <int... kTerms>
struct Series {
  using Result = double;
  explicit Series(MethodSize size) : pixels(by_size(size, 1, 2, 3)) {}
  [[nodiscard]] double run(std::size_t setting) const {
    constexpr std::array<int, sizeof...(kTerms)> kAll{kTerms...};
    double sum = 0.0;
    for (int i = 0; i < kAll.at(setting); ++i) {
      sum += (i % 2 == 0 ? 4.0 : -4.0) / (2 * i + 1);
    }
    return sum;
  }
  [[nodiscard]] double truth() const { return std::numbers::pi; }
  [[nodiscard]] double error(double found, double truth) const {
    return std::abs(found - truth);
  }
  [[nodiscard]] MethodScale scale() const { return {1, pixels}; }
  long long pixels;
};

struct Counted : Series<1, 10, 100> {
  using Series::Series;
  [[nodiscard]] double bytes(std::size_t setting) const { return 8.0 * double(setting + 1); }
};

struct NotANumber : Series<1, 10, 100> {
  using Series::Series;
  [[nodiscard]] double error(double /*found*/, double /*truth*/) const {
    return std::numeric_limits<double>::quiet_NaN();
  }
};

MethodWords words() {
  return {.module = "tests/core",
          .name = "series",
          .settings = {"1 term", "10 terms", "100 terms"},
          .error_norm = "absolute",
          .truth = "pi",
          .exact_error = 0.04,
          .exact_error_from = "four hundredths: the first term left out of 100"};
}

TEST(Method, GivesARecordForEachSetting) {
  const MethodRun run =
      run_method(Method::of<Series<1, 10, 100>>(words()),
                 {.size = MethodSize::large, .repeats = 3, .threads = 2, .command = "test"});
  ASSERT_EQ(run.records.size(), 3U);
  EXPECT_EQ(run.records[1].algorithm, "haarlight");
  EXPECT_EQ(run.records[1].mode, "series, 10 terms");
  EXPECT_EQ(run.records[1].error_norm, "absolute");
  EXPECT_DOUBLE_EQ(run.records[0].error, 4.0 - std::numbers::pi);
  EXPECT_EQ(run.records[0].conditions.pixels, 3);
  EXPECT_EQ(run.records[0].conditions.threads, 2);
  EXPECT_EQ(run.records[0].conditions.repeats, 3);
  EXPECT_LE(run.records[0].seconds_least, run.records[0].seconds);
  EXPECT_LE(run.records[0].seconds, run.records[0].seconds_most);
  EXPECT_THAT(run.grown, IsEmpty());
  EXPECT_TRUE(run.is_exact);
  const auto json = nlohmann::json::parse(tradeoff_json(run.records));
  EXPECT_EQ(json[2]["conditions"]["module"], "tests/core");
  EXPECT_EQ(json[2]["conditions"]["truth"], "pi");
  EXPECT_EQ(json[2]["conditions"]["size"], "large");
  EXPECT_EQ(json[2]["conditions"]["bytes_are"], "not counted");
}

TEST(Method, CountsBytesWhereTheInputDoes) {
  const MethodRun run = run_method(Method::of<Counted>(words()), {.repeats = 1});
  EXPECT_EQ(run.records[2].bytes, 24.0);
  const auto json = nlohmann::json::parse(tradeoff_json(run.records));
  EXPECT_FALSE(json[0]["conditions"].contains("bytes_are"));
}

TEST(Method, TellsErrorsThatGrow) {
  const MethodRun run = run_method(Method::of<Series<10, 1, 100>>(words()), {.repeats = 1});
  EXPECT_THAT(run.grown, ElementsAre(HasSubstr("\"10 terms\" is off by 0.858")));
  EXPECT_TRUE(run.is_exact);
}

TEST(Method, TellsAnExactSettingThatIsNot) {
  const MethodRun run = run_method(Method::of<Series<100, 10, 1>>(words()), {.repeats = 1});
  EXPECT_FALSE(run.is_exact);
  EXPECT_EQ(run.grown.size(), 2U);
  const MethodRun none = run_method(Method::of<NotANumber>(words()), {.repeats = 1});
  EXPECT_FALSE(none.is_exact);
  EXPECT_EQ(none.grown.size(), 2U);
}

/// What is larger than before, but within the exact setting's error, is rounding.
TEST(Method, TakesErrorsWithinTheExactOneForRounding) {
  MethodWords rough = words();
  rough.exact_error = 1.0;
  EXPECT_THAT(run_method(Method::of<Series<100, 10, 1>>(rough), {.repeats = 1}).grown,
              IsEmpty());
}

TEST(Method, RefusesAMethodThatDoesNotSayWhatItIs) {
  const auto with = [](auto change) {
    MethodWords changed = words();
    change(changed);
    return Method::of<Series<1, 10, 100>>(changed);
  };
  EXPECT_THROW((void)with([](MethodWords& w) { w.truth.clear(); }), ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.error_norm.clear(); }), ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.name.clear(); }), ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.module.clear(); }), ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.exact_error_from.clear(); }),
               ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.settings.resize(1); }), ContractViolation);
  EXPECT_THROW((void)with([](MethodWords& w) { w.settings[1] = w.settings[0]; }),
               ContractViolation);
  EXPECT_THROW((void)run_method(Method::of<Counted>(words()), {.repeats = 0}),
               ContractViolation);
}

TEST(Method, ListsMethodsAndRecordsInMarkdown) {
  const std::vector<Method> methods{Method::of<Counted>(words())};
  EXPECT_THAT(methods_markdown(methods),
              HasSubstr("| tests/core | series | 1 term; 10 terms; 100 terms | absolute | pi | "
                        "0.04: four hundredths"));
  const MethodRun run = run_method(methods[0], {.repeats = 1});
  EXPECT_THAT(records_markdown(run.records), HasSubstr("| series, 100 terms | 1 | 2 | "));
}

}  // namespace
}  // namespace haarlight
