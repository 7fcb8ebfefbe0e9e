// SPDX-License-Identifier: Apache-2.0
#include "bench/methods/all_methods.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/method_run.h"

namespace haarlight {

/// What GoogleTest shows of a method.
void PrintTo(const Method& method,  // NOLINT(readability-identifier-naming)
             std::ostream* out) {
  *out << method.words().module << ": " << method.words().name;
}

namespace bench {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
namespace fs = std::filesystem;

const fs::path kRoot = HAARLIGHT_SOURCE_DIR;

std::string text_of(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(kRoot / file).rdbuf();
  return text.str();
}

class EveryMethod : public ::testing::TestWithParam<Method> {};

/// The tolerance is the table's, which says where it comes from.
TEST_P(EveryMethod, IsExactAtItsExactSettingAndNoFurtherOffThanAtFasterOnes) {
  const MethodRun run = run_method(GetParam(), {.size = MethodSize::smallest, .repeats = 1});
  EXPECT_THAT(run.grown, IsEmpty());
  EXPECT_TRUE(run.is_exact) << run.records.back().error << ", allowed "
                            << GetParam().words().exact_error;
  EXPECT_GT(run.records.front().error, 0.0) << "nothing is traded";
  for (const TradeoffRecord& record : run.records) {
    EXPECT_GT(record.conditions.pixels, 0);
    EXPECT_GE(record.bytes, 0.0);
  }
}

TEST_P(EveryMethod, NamesTheFolderItIsIn) {
  EXPECT_TRUE(fs::is_directory(kRoot / GetParam().words().module));
}

INSTANTIATE_TEST_SUITE_P(Table, EveryMethod, ::testing::ValuesIn(all_methods()),
                         [](const auto& method) {
                           std::string name =
                               method.param.words().module + "_" + method.param.words().name;
                           std::replace_if(
                               name.begin(), name.end(),
                               [](unsigned char c) { return std::isalnum(c) == 0; }, '_');
                           return name;
                         });

TEST(AllMethods, HaveEveryTableOfTheTree) {
  const std::string collected = text_of("bench/methods/all_methods.cpp");
  int n = 0;
  for (const char* room :
       {"core", "firmware_iface", "session", "render", "http", "capture", "relight", "sim"}) {
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(kRoot / room)) {
      const std::string name = entry.path().filename().string();
      if (name.ends_with("_methods.h")) {
        EXPECT_THAT(collected,
                    HasSubstr('"' + fs::relative(entry.path(), kRoot).generic_string() + '"'));
        ++n;
      }
    }
  }
  EXPECT_GT(n, 0);
}

TEST(AllMethods, HaveNamesOfTheirOwn) {
  std::set<std::string> names;
  for (const Method& method : all_methods()) {
    EXPECT_TRUE(names.insert(method.words().module + ": " + method.words().name).second)
        << method.words().name;
  }
}

TEST(AllMethods, AreThoseOfTheDocument) {
  EXPECT_THAT(text_of("docs/numerics/methods.md"), HasSubstr(methods_markdown(all_methods())))
      << "haarlight_methods --list-markdown prints the table";
}

}  // namespace
}  // namespace bench
}  // namespace haarlight
