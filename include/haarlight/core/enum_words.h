// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <concepts>
#include <cstddef>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "haarlight/core/error.h"

/// @file
/// The words of an enum in files, messages and options: one table per type, next to the enum.
///
///     enum class Shutter { rolling, global };
///     inline constexpr auto kShutterWords =
///         std::to_array<std::string_view>({"rolling", "global"});
///     constexpr std::span<const std::string_view> words_of(Shutter) { return kShutterWords; }
///
///     to_string(Shutter::global)            // "global"
///     value_of<Shutter>("rolling")          // Shutter::rolling
///     json["shutter"].one_of<Shutter>()     // or an Error that lists the words

namespace haarlight {

/// Values count from 0; words_of() has one word for each, in their order.
template <class Enum>
concept EnumWithWords = requires(Enum value) {
  { words_of(value) } -> std::same_as<std::span<const std::string_view>>;
};

/// @throws ContractViolation  a value that the enum does not have
template <EnumWithWords Enum>
[[nodiscard]] std::string_view to_string(Enum value) {
  const std::span<const std::string_view> words = words_of(value);
  const auto index = static_cast<std::size_t>(value);
  HAARLIGHT_EXPECTS(index < words.size(), "a value of the enum");
  return words[index];
}

/// All words, in the order of the values.
template <EnumWithWords Enum>
[[nodiscard]] std::vector<std::string_view> all_words() {
  const std::span<const std::string_view> words = words_of(Enum{});
  return {words.begin(), words.end()};
}

/// All values, in their order.
template <EnumWithWords Enum>
[[nodiscard]] std::vector<Enum> all_values() {
  std::vector<Enum> values;
  for (std::size_t i = 0; i < words_of(Enum{}).size(); ++i) {
    values.push_back(static_cast<Enum>(i));
  }
  return values;
}

/// The value of a word; nothing if no value has it.
template <EnumWithWords Enum>
[[nodiscard]] std::optional<Enum> value_of(std::string_view word) {
  const std::span<const std::string_view> words = words_of(Enum{});
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (words[i] == word) {
      return static_cast<Enum>(i);
    }
  }
  return std::nullopt;
}

}  // namespace haarlight
