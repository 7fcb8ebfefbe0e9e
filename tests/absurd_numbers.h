// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cctype>
#include <functional>
#include <string>

#include <gtest/gtest.h>

#include "haarlight/core/error.h"

/// @file
/// A good TOML text with each of its numbers, one after the other, made absurd: no key of ours
/// takes such a number, so each must be refused with its file.

namespace haarlight::testing {

/// @param parse  throws Error for a bad text
inline void expect_absurd_numbers_refused(
    const std::string& good, const std::function<void(const std::string&)>& parse) {
  ASSERT_NO_THROW(parse(good));
  int n_numbers = 0;
  const auto is_digit = [&](std::size_t i) {
    return i < good.size() && std::isdigit(static_cast<unsigned char>(good[i])) != 0;
  };
  char quote = '\0';
  bool is_comment = false;
  for (std::size_t at = 0; at < good.size(); ++at) {
    const char c = good[at];
    is_comment = (is_comment || (c == '#' && quote == '\0')) && c != '\n';
    if (!is_comment && (c == '"' || c == '\'')) {
      quote = quote == '\0' ? c : quote == c ? '\0' : quote;
    }
    const bool is_start = at > 0 && (good[at - 1] == ' ' || good[at - 1] == '[') &&
                          (is_digit(at) || (c == '-' && is_digit(at + 1)));
    if (is_comment || quote != '\0' || !is_start) {
      continue;
    }
    std::size_t end = at + 1;
    while (is_digit(end) ||
           (end < good.size() && std::string("._e+-").find(good[end]) != std::string::npos)) {
      ++end;
    }
    ++n_numbers;
    for (const char* absurd : {"1e308", "-1e308", "nan", "inf", "1e18", "-1e18"}) {
      const std::string bad = good.substr(0, at) + absurd + good.substr(end);
      const std::size_t line = good.rfind('\n', at) + 1;
      EXPECT_THROW(parse(bad), Error)
          << good.substr(line, good.find('\n', at) - line) << " with " << absurd;
    }
    at = end - 1;
  }
  EXPECT_GT(n_numbers, 3) << "the text has numbers";
}

}  // namespace haarlight::testing
