// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

/// @file
/// Limits on untrusted text before a parser sees it. Parsers of nested text recurse per level,
/// or free what they have read level by level: 80 kB of "a.a.a..." would crash the program.
/// Every TOML text is checked here by ConfigTable, every JSON text by parse_json.

namespace haarlight {

/// The deepest TOML that is read: this many open brackets at once, and this many parts of a
/// dotted key or table name: 288 levels of tables at most, which fit 256 KiB of stack in every
/// build (tests/core/text_limits_test.cpp). A rig file has 2.
inline constexpr int kMaxTomlBrackets = 16;
inline constexpr int kMaxTomlKeyParts = 16;
inline constexpr std::size_t kMaxTomlBytes = std::size_t{16} << 20U;

/// The deepest JSON that is read, in open brackets. A session has 7.
inline constexpr int kMaxJsonBrackets = 64;
inline constexpr std::size_t kMaxJsonBytes = std::size_t{1} << 30U;

/// @param name  names the file in the error
/// @throws Error  too large, or too deep at file:line
void require_toml_limits(std::string_view text, const std::string& name);

/// @param max_bytes  at most kMaxJsonBytes
/// @throws Error  too large, or too deep (with the byte offset)
void require_json_limits(std::string_view text, const std::string& where,
                         std::size_t max_bytes = kMaxJsonBytes);

/// @throws Error  as reported by a JSON parser: malformed at byte `byte`
[[noreturn]] void throw_broken_json(std::size_t byte, const std::string& where);

/// The only way to parse JSON text.
/// @tparam Json  nlohmann::json or nlohmann::ordered_json, which only a .cpp knows
/// @param look   nlohmann's parser callback
/// @throws Error  too large, too deep, or not JSON (with the byte)
template <class Json, class Look = std::nullptr_t>
[[nodiscard]] Json parse_json(std::string_view text, const std::string& where,
                              Look look = nullptr) {
  require_json_limits(text, where);
  try {
    return Json::parse(text.begin(), text.end(), look);
  } catch (const typename Json::parse_error& error) {
    throw_broken_json(error.byte, where);
  } catch (const typename Json::out_of_range&) {  // a number like 1e999
    throw_broken_json(0, where);
  }
}

}  // namespace haarlight
