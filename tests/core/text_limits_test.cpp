// SPDX-License-Identifier: Apache-2.0
#include "core/text_limits.h"

#include <functional>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <pthread.h>

#include "core/config_table.h"
#include "haarlight/core/error.h"

namespace haarlight {
namespace {

using ::testing::HasSubstr;

std::string refusal(const std::function<void()>& work) {
  try {
    work();
  } catch (const Error& error) {
    EXPECT_FALSE(error.hint().empty());
    return error.what();
  }
  return "nothing was refused";
}

std::string repeat(const std::string& text, int n) {
  std::string out;
  for (int i = 0; i < n; ++i) {
    out += text;
  }
  return out;
}

std::string refusal_of_toml(const std::string& text) {
  return refusal([&] { (void)ConfigTable::parse_text(text, "x.toml"); });
}

/// Runs `work` on a thread with this much stack.
void run_on_stack(std::size_t bytes, const std::function<void()>& work) {
  pthread_attr_t attributes;
  ASSERT_EQ(pthread_attr_init(&attributes), 0);
  ASSERT_EQ(pthread_attr_setstacksize(&attributes, bytes), 0);
  pthread_t thread{};
  const auto body = [](void* argument) -> void* {
    (*static_cast<const std::function<void()>*>(argument))();
    return nullptr;
  };
  auto argument = work;
  ASSERT_EQ(pthread_create(&thread, &attributes, body, &argument), 0);
  ASSERT_EQ(pthread_join(thread, nullptr), 0);
  ASSERT_EQ(pthread_attr_destroy(&attributes), 0);
}

TEST(TomlLimits, RefuseDeepTextsInEveryForm) {
  constexpr int kDeep = 100000;
  const std::string deep = repeat("a.", kDeep);
  for (const std::string& text :
       {deep + "a = 1\n", "[" + deep + "a]\n", "[[" + deep + "a]]\n",
        "x = { " + deep + "a = 1 }\n", repeat("\"a\".", kDeep) + "a = 1\n",
        repeat("'a' . ", kDeep) + "a = 1\n", "x = " + repeat("[", kDeep),
        "x = " + repeat("[", kDeep) + repeat("]", kDeep),
        "x = " + repeat("{a=", kDeep) + "1" + repeat("}", kDeep),
        "x = " + repeat("[{a.b.c=", kDeep), "x = [\n# [\n" + repeat("[\n", kDeep)}) {
    const std::string message = refusal_of_toml("schema = 1\n" + text);
    EXPECT_THAT(message, HasSubstr("x.toml:")) << text.substr(0, 20);
    EXPECT_THAT(message, ::testing::AnyOf(HasSubstr("parts"), HasSubstr("brackets")))
        << text.substr(0, 20);
  }
}

TEST(TomlLimits, NameTheLine) {
  EXPECT_THAT(
      refusal_of_toml("a = \"\"\"\n[[[\n\"\"\"\nb = 'x'\n" + repeat("c.", 20) + "c = 1\n"),
      HasSubstr("x.toml:5: a key of more than 16 parts"));
}

TEST(TomlLimits, TakeWhatOnlyLooksDeep) {
  const std::string dots = repeat(".", 40);
  const std::string brackets = repeat("[", 40);
  // NOLINTBEGIN(performance-inefficient-string-concatenation): the texts are to be read
  for (const std::string& text :
       {"a = \"" + dots + brackets + "\"\n", "a = '" + dots + brackets + "'\n",
        "a = \"\\\"" + dots + brackets + "\"\n", "# " + dots + brackets + "\n",
        "a = \"\"\"\n\"" + brackets + "\\\"\"\"" + dots + "\"\"\"\"\"\n",
        "a = '''\n'" + brackets + "''" + dots + "'''''\n", "\"" + dots + brackets + "\" = 1\n",
        "a = [" + repeat("1.5, ", 100) + "1.5]\n",
        "a = \"\"\nb = ''\nc = \"" + brackets + "\"\n", repeat("[[a.b]]\nc = 1.5\n", 50)}) {
    // NOLINTEND(performance-inefficient-string-concatenation)
    EXPECT_NO_THROW((void)ConfigTable::parse_text(text, "x.toml")) << text;
  }
}

TEST(TomlLimits, WhatIsTakenFitsASmallStack) {
  const std::string key = repeat("a.", kMaxTomlKeyParts - 1) + "a";
  std::string deepest = "[" + key + "]\n" + key + " = ";
  for (int i = 0; i < kMaxTomlBrackets; ++i) {
    deepest += "{" + key + " = ";
  }
  deepest += "1" + repeat("}", kMaxTomlBrackets) + "\n";
  const std::string lists =
      "x = " + repeat("[", kMaxTomlBrackets) + repeat("]", kMaxTomlBrackets) + "\n";
  run_on_stack(std::size_t{256} << 10U, [&] {
    EXPECT_NO_THROW((void)ConfigTable::parse_text(deepest, "x.toml"));
    EXPECT_NO_THROW((void)ConfigTable::parse_text(lists, "x.toml"));
    EXPECT_THROW((void)ConfigTable::parse_text(deepest + "]", "x.toml"), Error);
  });
}

TEST(TomlLimits, RefuseWhatIsTooLarge) {
  EXPECT_THAT(refusal_of_toml(std::string(kMaxTomlBytes + 1, '\n')), HasSubstr("bytes, more"));
}

TEST(JsonLimits, RefuseDeepTexts) {
  const auto parse = [](const std::string& text) {
    return refusal([&] { (void)parse_json<nlohmann::json>(text, "x.json"); });
  };
  constexpr int kDeep = 100000;
  EXPECT_THAT(parse(repeat("[", kDeep)), HasSubstr("x.json: more than 64 brackets"));
  EXPECT_THAT(parse(repeat("[", kDeep) + repeat("]", kDeep)), HasSubstr("at byte 64"));
  EXPECT_THAT(parse(repeat("{\"a\":", kDeep) + "1" + repeat("}", kDeep)),
              HasSubstr("brackets"));
  EXPECT_THAT(parse("[\"\\\\\", " + repeat("[{\"a\":", kDeep)), HasSubstr("brackets"));
  EXPECT_THAT(parse("{\"a\": 1,"), HasSubstr("not JSON: broken at byte"));
  EXPECT_THAT(parse("[1e999]"), HasSubstr("number too large"));
}

TEST(JsonLimits, TakeWhatOnlyLooksDeep) {
  const std::string brackets = repeat("[{", 100);
  EXPECT_EQ(parse_json<nlohmann::json>("[\"\\\"" + brackets + "\\\\\"]", "x")[0],
            "\"" + brackets + "\\");
  const std::string wide = "[" + repeat("[1],", 1000) + "[]]";
  EXPECT_EQ(parse_json<nlohmann::json>(wide, "x").size(), 1001U);
}

TEST(JsonLimits, WhatIsTakenFitsASmallStack) {
  const std::string deepest = repeat("[", kMaxJsonBrackets) + repeat("]", kMaxJsonBrackets);
  run_on_stack(std::size_t{256} << 10U, [&] {
    const auto json = parse_json<nlohmann::json>(deepest, "x.json");
    nlohmann::json copy = json;
    copy.push_back(1);
    EXPECT_EQ(json.dump(), deepest);
  });
}

}  // namespace
}  // namespace haarlight
