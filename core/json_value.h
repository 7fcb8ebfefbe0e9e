// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"

/// @file
/// An external JSON text, read value by value: whatever is missing or of the wrong type throws
/// an Error that names the file and the path in it ("session.json: frames[3].shot"). Only the
/// .cpp includes nlohmann-json.

namespace haarlight {

/// One value of a document. Copies refer to the same document. Safe to share (const calls).
class JsonValue {
 public:
  /// @param where  the file's name, for messages
  /// @param hint   what to do about a value that is missing or of the wrong type
  /// @throws Error  not JSON (with the byte), or beyond core/text_limits.h
  [[nodiscard]] static JsonValue parse(
      std::string_view text, const std::string& where,
      const std::string& hint = "compare with docs/reference/session-format.md");

  [[nodiscard]] bool has(std::string_view key) const;
  /// A member of this object. @throws Error  not an object, no such member
  [[nodiscard]] JsonValue operator[](std::string_view key) const;
  /// The elements of this array. @throws Error  not an array
  [[nodiscard]] std::vector<JsonValue> elements() const;

  /// @throws Error  of another type, or outside [min, max]
  [[nodiscard]] double number(double min = -1.7976931348623157e308,
                              double max = 1.7976931348623157e308) const;
  [[nodiscard]] std::int64_t integer(std::int64_t min, std::int64_t max) const;
  [[nodiscard]] std::uint64_t unsigned_integer() const;
  [[nodiscard]] bool truth() const;
  [[nodiscard]] std::string text() const;
  /// The index of one of the listed words.
  [[nodiscard]] std::size_t choice(const std::vector<std::string_view>& words) const;
  /// The enum's value of this word.
  template <EnumWithWords Enum>
  [[nodiscard]] Enum one_of() const {
    return static_cast<Enum>(choice(all_words<Enum>()));
  }

  [[nodiscard]] bool is_object() const;
  [[nodiscard]] bool is_array() const;
  [[nodiscard]] bool is_number() const;
  /// This value as JSON text.
  [[nodiscard]] std::string dump() const;
  /// "file: a.b[3]", for the caller's own messages.
  [[nodiscard]] const std::string& location() const noexcept { return location_; }
  /// @throws Error  with this value's path
  [[noreturn]] void refuse(const std::string& what, const std::string& hint) const;

 private:
  struct Document;
  JsonValue(std::shared_ptr<const Document> document, const void* node, std::string location);
  std::shared_ptr<const Document> document_;
  const void* node_ = nullptr;
  std::string location_;
};

}  // namespace haarlight
