// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"

/// @file
/// Reads a hand-written TOML file key by key. Every problem is collected with file:line, so the
/// user sees all of them at once; a key that was never read is a problem too, with the nearest
/// known name as the hint. Only the .cpp sees toml++.
///
///     ConfigTable root = ConfigTable::parse_file("rig.toml");
///     const double pitch = root.number("pitch", {.min = 0.1});
///     root.finish();  // throws Error with every problem found so far

namespace haarlight {

/// Allowed values, inclusive.
struct Range {
  double min = -std::numeric_limits<double>::max();
  double max = std::numeric_limits<double>::max();
};

/// One table of a TOML file. Copies refer to the same file. One thread. The reading calls
/// return the value, or record a problem and return a harmless placeholder.
class ConfigTable {
 public:
  /// @throws Error  not readable, beyond core/text_limits.h, or not TOML: with file:line:column
  [[nodiscard]] static ConfigTable parse_file(const std::filesystem::path& path);
  [[nodiscard]] static ConfigTable parse_text(std::string_view text, const std::string& name);

  [[nodiscard]] bool has(std::string_view key) const;
  /// Every key of this table in file order, for tables with user-chosen keys. Each must still
  /// be read.
  [[nodiscard]] std::vector<std::string> keys() const;
  [[nodiscard]] bool is_text(std::string_view key) const;
  [[nodiscard]] bool is_flag(std::string_view key) const;

  // A required key.
  double number(std::string_view key, Range range = {});
  std::int64_t integer(std::string_view key, Range range = {});
  std::string text(std::string_view key);
  /// Exactly `count` numbers, or any count from 1 up when `count` is 0.
  std::vector<double> numbers(std::string_view key, std::size_t count, Range range = {});
  std::vector<std::string> texts(std::string_view key);
  /// Rows of numbers, `rows` x `cols`, returned row by row; any number of rows when `rows` is
  /// 0.
  std::vector<double> matrix(std::string_view key, std::size_t rows, std::size_t cols,
                             Range range = {});
  /// One of the listed words; the index is returned.
  std::size_t choice(std::string_view key, const std::vector<std::string_view>& words);
  /// The enum's value of this word.
  template <EnumWithWords Enum>
  Enum one_of(std::string_view key) {
    return static_cast<Enum>(choice(key, all_words<Enum>()));
  }

  // An optional key.
  double number_or(std::string_view key, double fallback, Range range = {});
  std::int64_t integer_or(std::string_view key, std::int64_t fallback, Range range = {});
  std::string text_or(std::string_view key, std::string_view fallback);
  bool flag_or(std::string_view key, bool fallback);
  std::vector<double> numbers_or(std::string_view key, const std::vector<double>& fallback,
                                 Range range = {});
  std::size_t choice_or(std::string_view key, const std::vector<std::string_view>& words,
                        std::size_t fallback);
  template <EnumWithWords Enum>
  Enum one_of_or(std::string_view key, Enum fallback) {
    return static_cast<Enum>(
        choice_or(key, all_words<Enum>(), static_cast<std::size_t>(fallback)));
  }

  /// `[key]`, if present.
  std::optional<ConfigTable> table(std::string_view key);
  /// Every `[[key]]`, in file order.
  std::vector<ConfigTable> tables(std::string_view key);

  /// "file:line" of a key, or of the table when the key is missing.
  [[nodiscard]] std::string where(std::string_view key = {}) const;
  /// Records a semantic problem found by the caller.
  void problem(std::string_view key, std::string what, std::string hint);

  /// Whether any was found so far in the file: what is built of it will be thrown away.
  [[nodiscard]] bool has_problems() const;

  /// Reports unknown keys of every table of this file that was opened.
  /// @throws Error  listing the first 100 problems, the first one's location as `where`
  void finish();

 private:
  struct Document;
  struct Node;
  ConfigTable(std::shared_ptr<Document> document, std::shared_ptr<Node> node);
  void require_range(std::string_view key, const std::vector<double>& values, Range range);
  std::shared_ptr<Document> document_;
  std::shared_ptr<Node> node_;
};

/// The candidate nearest to `word` by edit distance, or empty when none is within 3 edits.
[[nodiscard]] std::string nearest_word(std::string_view word,
                                       const std::vector<std::string>& candidates);

}  // namespace haarlight
