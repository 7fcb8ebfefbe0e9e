// SPDX-License-Identifier: Apache-2.0
#include "http/parse.h"

#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <rapidcheck/gtest.h>

#include "haarlight/core/error.h"
#include "http/json_text.h"

namespace haarlight::http {
namespace {

using Segments = std::vector<std::string>;

TEST(ParseTarget, CutsPathAndQueryAndDecodesThem) {
  const auto target = parse_target("/v1/sessions/a%20b?from=3&name=x+y%26&flag");
  ASSERT_TRUE(target);
  EXPECT_EQ(target->segments, (Segments{"v1", "sessions", "a b"}));
  EXPECT_EQ(target->query.at("from"), "3");
  EXPECT_EQ(target->query.at("name"), "x y&");
  EXPECT_EQ(target->query.at("flag"), "");
}

TEST(ParseTarget, TakesTheRootAndATrailingSlash) {
  EXPECT_TRUE(parse_target("/")->segments.empty());
  EXPECT_EQ(parse_target("/docs/")->segments, Segments{"docs"});
  EXPECT_TRUE(parse_target("/docs/")->ends_with_slash);
}

TEST(ParseTarget, RefusesEveryWayOutOfAFolder) {
  for (const char* bad : {"", "a", "//", "//a", "/a//b", "/..", "/a/../b", "/%2e%2e/x", "/./a",
                          "/a%2fb", "/a%5cb", "/a\\b", "/a%00b", "/a%0ab", "/%", "/%4", "/%zz",
                          "/ok?x=%g1", "http://host/a"}) {
    EXPECT_FALSE(parse_target(bad)) << bad;
  }
}

TEST(FindCookie, FindsTheOneOfThatName) {
  EXPECT_EQ(find_cookie("a=1; haarlight=abc; b=2", "haarlight"), "abc");
  EXPECT_EQ(find_cookie("haarlight=\"abc\"", "haarlight"), "abc");
  EXPECT_FALSE(find_cookie("xhaarlight=abc; haarlight", "haarlight"));
  EXPECT_FALSE(find_cookie("", "haarlight"));
}

TEST(ParseAuthority, TellsNumbersFromNames) {
  EXPECT_TRUE(parse_authority("127.0.0.1:8480")->is_loopback);
  EXPECT_TRUE(parse_authority("LOCALHOST")->is_loopback);
  EXPECT_TRUE(parse_authority("[::1]:80")->is_loopback);
  EXPECT_FALSE(parse_authority("10.0.0.7")->is_loopback);
  EXPECT_TRUE(parse_authority("10.0.0.7")->is_ip_literal);
  EXPECT_FALSE(parse_authority("evil.example")->is_ip_literal);
  EXPECT_FALSE(parse_authority("127.0.0.1.evil.example")->is_loopback);
  EXPECT_FALSE(parse_authority("localhost.evil.example")->is_loopback);
}

TEST(ParseAuthority, RefusesWhatIsNone) {
  for (const char* bad : {"", ":80", "a:", "a:99999999", "a:b", "[::1", "[::1]x", "a b", "a/b",
                          "user@host", "::1"}) {
    EXPECT_FALSE(parse_authority(bad)) << bad;
  }
}

TEST(PathPattern, CapturesByName) {
  const PathPattern pattern("/v1/sessions/{id}/shots/{n}");
  const auto captures = pattern.match({"v1", "sessions", "s 1", "shots", "7"});
  ASSERT_TRUE(captures);
  EXPECT_EQ(captures->at("id"), "s 1");
  EXPECT_EQ(captures->at("n"), "7");
  EXPECT_FALSE(pattern.match({"v1", "sessions", "s", "shots"}));
}

TEST(PathPattern, ALiteralPrecedesACapture) {
  EXPECT_TRUE(PathPattern("/v1/new").precedes(PathPattern("/v1/{id}")));
  EXPECT_FALSE(PathPattern("/v1/{id}").precedes(PathPattern("/v1/new")));
  EXPECT_TRUE(PathPattern("/v1/{id}/x").precedes(PathPattern("/v1/new")));
}

TEST(PathPattern, RefusesAMistake) {
  for (const char* bad : {"", "v1", "/a//b", "/{}", "/{a", "/{a}/{a}"}) {
    EXPECT_THROW(PathPattern{bad}, ContractViolation) << bad;
  }
}

TEST(JsonQuote, ReplacesBytesThatAreNotUtf8) {
  EXPECT_EQ(json_quote("a\"\\\n\x01"), "\"a\\\"\\\\\\n\\u0001\"");
  EXPECT_EQ(json_quote("\xc0\xaf"), "\"\\ufffd\\ufffd\"");
  EXPECT_EQ(json_quote("\xe2\x82\xac"), "\"\xe2\x82\xac\"");
}

RC_GTEST_PROP(JsonQuote, IsAlwaysReadByAJsonParser, (const std::string& text)) {
  RC_ASSERT(nlohmann::json::parse(json_quote(text)).is_string());
}

RC_GTEST_PROP(ParseTarget, UndoesPercentEncodingOfAnyBytes, (const std::string& value)) {
  std::string encoded;
  for (const char c : value) {
    constexpr char kHex[] = "0123456789ABCDEF";
    const auto u = static_cast<unsigned char>(c);
    encoded += {'%', kHex[u >> 4U], kHex[u & 15U]};
  }
  RC_ASSERT(parse_target("/a?v=" + encoded)->query.at("v") == value);
}

}  // namespace
}  // namespace haarlight::http
