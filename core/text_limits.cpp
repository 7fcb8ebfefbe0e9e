// SPDX-License-Identifier: Apache-2.0
#include "core/text_limits.h"

#include <algorithm>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight {

namespace {

void require_size(std::string_view text, std::size_t max_bytes, const std::string& where) {
  if (text.size() > max_bytes) {
    throw Error(fmt::format("{} bytes, more than the {} that are read", text.size(), max_bytes),
                where, "is this the right file? give a smaller one");
  }
}

/// One past the TOML string that begins at `at`. Counts the lines in it. Where the string is
/// malformed, the parser stops there, and what follows does not matter.
std::size_t end_of_toml_string(std::string_view text, std::size_t at, std::size_t& line) {
  const char quote = text[at];
  const bool is_basic = quote == '"';
  const std::string three(3, quote);
  const bool is_long = text.substr(at, 3) == three;
  at += is_long ? 3 : 1;
  while (at < text.size()) {
    if (text[at] == '\n') {
      if (!is_long) {
        return at;
      }
      ++line;
    }
    if (text[at] == quote && !is_long) {
      return at + 1;
    }
    if (text[at] == quote && text.substr(at, 3) == three) {
      // Up to two quotes may precede the three that end it.
      at += 3;
      for (int i = 0; i < 2 && at < text.size() && text[at] == quote; ++i) {
        ++at;
      }
      return at;
    }
    const bool is_escape =
        is_basic && text[at] == '\\' && at + 1 < text.size() && text[at + 1] != '\n';
    at += is_escape ? 2 : 1;
  }
  return at;
}

}  // namespace

void require_toml_limits(std::string_view text, const std::string& name) {
  require_size(text, kMaxTomlBytes, name);
  std::size_t line = 1;
  int n_brackets = 0;
  int n_dots = 0;  // since the last character that cannot be inside a dotted key
  const auto refuse = [&](const std::string& what, const char* hint) {
    throw Error(what, fmt::format("{}:{}", name, line), hint);
  };
  std::size_t at = 0;
  while (at < text.size()) {
    const char c = text[at];
    if (c == '"' || c == '\'') {
      at = end_of_toml_string(text, at, line);
      continue;
    }
    if (c == '#') {
      at = std::min(text.find('\n', at), text.size());
      continue;
    }
    ++at;
    if (c == '.') {
      if (++n_dots >= kMaxTomlKeyParts) {
        refuse(fmt::format("a key of more than {} parts", kMaxTomlKeyParts),
               "no key here has more than three: remove it");
      }
      continue;
    }
    if (c == '[' || c == '{') {
      if (++n_brackets > kMaxTomlBrackets) {
        refuse(fmt::format("more than {} brackets within each other", kMaxTomlBrackets),
               "no value here needs more than two: remove it");
      }
    } else if (c == ']' || c == '}') {
      n_brackets = std::max(n_brackets - 1, 0);
    } else if (c == '\n') {
      ++line;
    } else if (c != ',' && c != '=') {
      continue;
    }
    n_dots = 0;
  }
}

void require_json_limits(std::string_view text, const std::string& where,
                         std::size_t max_bytes) {
  require_size(text, max_bytes, where);
  int n_brackets = 0;
  bool is_text = false;
  for (std::size_t at = 0; at < text.size(); ++at) {
    const char c = text[at];
    if (is_text) {
      at += c == '\\' ? 1 : 0;
      is_text = c != '"';
    } else if (c == '"') {
      is_text = true;
    } else if (c == '[' || c == '{') {
      if (++n_brackets > kMaxJsonBrackets) {
        throw Error(fmt::format("more than {} brackets within each other, at byte {}",
                                kMaxJsonBrackets, at),
                    where, "this is no file of haarlight's: give the right one");
      }
    } else if (c == ']' || c == '}') {
      n_brackets = std::max(n_brackets - 1, 0);
    }
  }
}

void throw_broken_json(std::size_t byte, const std::string& where) {
  throw Error(
      byte == 0 ? "not JSON: a number too large for any use"
                : fmt::format("not JSON: broken at byte {}", byte),
      where,
      "correct it there; a file that was damaged or cut short: take it from a backup, or "
      "make it again");
}

}  // namespace haarlight
