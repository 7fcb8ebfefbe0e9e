// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

/// @file
/// Numbers in mesh files, as bytes and as text.

namespace haarlight::render {

enum class NumberType : std::uint8_t { i8, u8, i16, u16, i32, u32, i64, u64, f32, f64 };

[[nodiscard]] std::size_t size_of(NumberType type);

/// Appends the numbers that `bytes` are; a last part of one is ignored.
void append_numbers(std::string_view bytes, NumberType type, std::endian order,
                    std::vector<double>& values);

/// Takes numbers off a text, one by one, between white space.
class NumberText {
 public:
  explicit NumberText(std::string_view text, std::size_t at = 0) : text_(text), at_(at) {}

  /// The next number; nothing at the end or before what is none: at() tells which.
  [[nodiscard]] std::optional<double> take();
  /// Skips white space. @return  whether there is no more
  bool is_at_end();
  /// Where the next number begins, once take() or is_at_end() has skipped what is before it.
  [[nodiscard]] std::size_t at() const { return at_; }

 private:
  std::string_view text_;
  std::size_t at_ = 0;
};

/// How many values a file may hold, in whatever form (cell_mesh_io.h).
class ValueBudget {
 public:
  explicit ValueBudget(std::size_t n_file_bytes)
      : left_(64 * n_file_bytes + (std::size_t{1} << 23U)) {}
  /// @return  whether there was room for so many more
  [[nodiscard]] bool take(std::size_t n_values) {
    if (n_values > left_) {
      return false;
    }
    left_ -= n_values;
    return true;
  }
  [[nodiscard]] std::size_t left() const { return left_; }

 private:
  std::size_t left_;
};

}  // namespace haarlight::render
