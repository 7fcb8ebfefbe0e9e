// SPDX-License-Identifier: Apache-2.0
#include "core/config_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "haarlight/core/error.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;

std::string message_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const Error& error) {
    return error.what();
  }
  return "nothing was thrown";
}

TEST(ConfigTable, ReadsEveryKindOfValue) {
  ConfigTable t = ConfigTable::parse_text(
      "a = 1.5\nb = 3\nc = 'word'\nd = [1, 2.5]\ne = [[1, 2], [3, 4]]\nf = true\n[g]\nh = 1\n"
      "[[i]]\nj = 1\n[[i]]\nj = 2\n",
      "x.toml");
  EXPECT_EQ(t.number("a"), 1.5);
  EXPECT_EQ(t.integer("b"), 3);
  EXPECT_EQ(t.text("c"), "word");
  EXPECT_EQ(t.numbers("d", 2), (std::vector<double>{1, 2.5}));
  EXPECT_EQ(t.matrix("e", 2, 2), (std::vector<double>{1, 2, 3, 4}));
  EXPECT_TRUE(t.flag_or("f", false));
  EXPECT_EQ(t.table("g")->number("h"), 1.0);
  auto tables = t.tables("i");
  ASSERT_EQ(tables.size(), 2U);
  EXPECT_EQ(tables[0].integer("j") + tables[1].integer("j"), 3);
  EXPECT_NO_THROW(t.finish());
}

TEST(ConfigTable, ReportsAllProblemsWithTheirLines) {
  ConfigTable t = ConfigTable::parse_text("pich = 3\nname = 7\nsize = 'x'\n", "x.toml");
  const std::string message = message_of([&] {
    t.number("pitch");
    t.text("name");
    t.number("size");
    t.finish();
  });
  EXPECT_THAT(message, HasSubstr("pitch is missing"));
  EXPECT_THAT(message, HasSubstr("x.toml:2: name is not a text"));
  EXPECT_THAT(message, HasSubstr("x.toml:3: size is not a number"));
  EXPECT_THAT(message, HasSubstr("x.toml:1: unknown key pich"));
  EXPECT_THAT(message, HasSubstr("did you mean pitch?"));
}

TEST(ConfigTable, RefusesNumbersOutOfRangeAndNotFinite) {
  ConfigTable t = ConfigTable::parse_text("a = 11\nb = inf\nc = nan\nd = 1.5\n", "x.toml");
  const std::string message = message_of([&] {
    t.number("a", {.min = 0.0, .max = 10.0});
    t.number("b");
    t.number("c");
    t.integer("d");
    t.finish();
  });
  EXPECT_THAT(
      message,
      HasSubstr("x.toml:1: a = 11 is out of range\n  hint: write a number from 0 to 10"));
  EXPECT_THAT(message, HasSubstr("x.toml:2"));
  EXPECT_THAT(message, HasSubstr("x.toml:3"));
  EXPECT_THAT(message, HasSubstr("x.toml:4: d = 1.5 is not a whole number"));
}

TEST(ConfigTable, NamesThePositionOfASyntaxError) {
  EXPECT_THAT(message_of([] { (void)ConfigTable::parse_text("a = 1\nb = = 2\n", "x.toml"); }),
              HasSubstr("x.toml:2:"));
}

TEST(ConfigTable, RefusesAMissingFile) {
  EXPECT_THAT(message_of([] { (void)ConfigTable::parse_file("/nowhere/x.toml"); }),
              HasSubstr("/nowhere/x.toml: cannot open"));
}

TEST(ConfigTable, ListsTheWordsOfAChoice) {
  ConfigTable t = ConfigTable::parse_text("mode = 'fats'\n", "x.toml");
  EXPECT_THAT(message_of([&] {
                t.choice("mode", {"fast", "exact"});
                t.finish();
              }),
              HasSubstr("write one of \"fast\" | \"exact\""));
}

TEST(NearestWord, FindsAWordWithinThreeEdits) {
  EXPECT_EQ(nearest_word("exposre_us", {"exposure_us", "fps"}), "exposure_us");
  EXPECT_EQ(nearest_word("completely_else", {"exposure_us", "fps"}), "");
}

}  // namespace
}  // namespace haarlight
