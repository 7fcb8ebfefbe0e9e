// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

/// @file
/// The text header of a `.ptm` or `.rti`: words between white space, then bytes. Every error
/// names the file and the byte offset.

namespace haarlight::relight {

class HeaderReader {
 public:
  /// @param where  names the file, for messages
  HeaderReader(std::string_view bytes, std::string where)
      : bytes_(bytes), where_(std::move(where)) {}

  /// The text up to the next LF, which is consumed too; a CR before it is not part of it.
  [[nodiscard]] std::string_view line();
  /// The next word; at most 64 bytes long. @throws Error  none, or longer
  [[nodiscard]] std::string_view word();
  /// The next word as a number. @throws Error  no finite number, or outside [min, max]
  [[nodiscard]] double number(double min, double max, std::string_view what);
  [[nodiscard]] std::int64_t integer(std::int64_t min, std::int64_t max, std::string_view what);
  /// Skips blanks and one line end, after which the bytes begin.
  /// @throws Error  anything else is found
  void end_of_header();

  [[nodiscard]] bool is_at_end() const noexcept { return at_ >= bytes_.size(); }
  [[nodiscard]] char peek() const noexcept { return is_at_end() ? '\0' : bytes_[at_]; }
  /// Offset from which the next word is read.
  [[nodiscard]] std::size_t offset() const noexcept { return at_; }
  [[nodiscard]] std::string_view rest() const noexcept { return bytes_.substr(at_); }
  /// @throws Error  with the offset of the last word, or `offset`
  [[noreturn]] void refuse(const std::string& what) const;
  [[noreturn]] void refuse_at(std::size_t offset, const std::string& what,
                              const std::string& hint) const;

 private:
  std::string_view bytes_;
  std::string where_;
  std::size_t at_ = 0;
  std::size_t word_ = 0;
};

/// "FILE: byte N": a location in a file.
[[nodiscard]] std::string location_in_file(const std::string& file, std::size_t offset);

}  // namespace haarlight::relight
