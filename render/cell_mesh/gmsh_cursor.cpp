// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/gmsh_cursor.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <optional>
#include <system_error>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "render/cell_mesh/mesh_numbers.h"

namespace haarlight::render {

namespace {

constexpr const char* kCutShort = "the file is cut short, or its counts are wrong";
constexpr const char* kSaveAgain = "the file is damaged: save the mesh again";
constexpr std::string_view kSpaces = " \t\r\n\v\f";

template <class T>
T number_of(std::string_view bytes, std::endian order) {
  std::array<char, sizeof(T)> number{};
  std::memcpy(number.data(), bytes.data(), sizeof(T));
  if (order != std::endian::native) {
    std::reverse(number.begin(), number.end());
  }
  return std::bit_cast<T>(number);
}

template <class T>
std::optional<T> whole_number(std::string_view word) {
  T number = 0;
  const auto [end, problem] = std::from_chars(word.data(), word.data() + word.size(), number);
  return problem == std::errc() && end == word.data() + word.size() ? std::optional(number)
                                                                    : std::nullopt;
}

}  // namespace

std::string GmshCursor::location(std::size_t at) const {
  if (coding_.is_binary) {
    return fmt::format("{}: byte {}", name_, at);
  }
  const auto end = bytes_.begin() + static_cast<std::ptrdiff_t>(std::min(at, bytes_.size()));
  return fmt::format("{}:{}", name_, 1 + std::count(bytes_.begin(), end, '\n'));
}

void GmshCursor::fail(const std::string& what, const std::string& hint, std::size_t at) const {
  throw Error(what, location(at), hint);
}

bool GmshCursor::is_at_end() {
  at_ = std::min(bytes_.find_first_not_of(kSpaces, at_), bytes_.size());
  return at_ == bytes_.size();
}

std::size_t GmshCursor::next_at() {
  if (!coding_.is_binary) {
    is_at_end();
  }
  return at_;
}

std::string_view GmshCursor::take_line() {
  const std::size_t end = std::min(bytes_.find('\n', at_), bytes_.size());
  std::string_view line = bytes_.substr(at_, end - at_);
  at_ = std::min(end + 1, bytes_.size());
  line.remove_prefix(std::min(line.find_first_not_of(kSpaces), line.size()));
  return line.substr(0, line.find_last_not_of(kSpaces) + 1);
}

void GmshCursor::skip_past(const std::string& mark, std::size_t from) {
  for (std::size_t at = at_; (at = bytes_.find(mark, at)) != std::string_view::npos; ++at) {
    const std::size_t end = at + mark.size();
    const bool is_alone = bytes_[at - 1] == '\n' &&
                          (end == bytes_.size() || bytes_[end] == '\n' || bytes_[end] == '\r');
    if (is_alone) {
      at_ = end;
      return;
    }
  }
  fail(fmt::format("no {} before the end", mark), "the file is cut short: copy it again", from);
}

std::string_view GmshCursor::take_word() {
  if (is_at_end()) {
    fail("the file ends where a number must follow", kCutShort, at_);
  }
  const std::size_t end = std::min(bytes_.find_first_of(kSpaces, at_), bytes_.size());
  const std::string_view word = bytes_.substr(at_, end - at_);
  at_ = end;
  return word;
}

std::uint64_t GmshCursor::take_text_count() {
  const std::string_view word = take_word();
  const std::optional<std::uint64_t> number = whole_number<std::uint64_t>(word);
  if (!number) {
    fail(fmt::format("'{}' instead of a count or a tag", word.substr(0, 60)), kSaveAgain,
         at_ - word.size());
  }
  return *number;
}

std::int64_t GmshCursor::take_text_integer() {
  const std::string_view word = take_word();
  const std::optional<std::int64_t> number = whole_number<std::int64_t>(word);
  if (!number) {
    fail(fmt::format("'{}' instead of a whole number", word.substr(0, 60)), kSaveAgain,
         at_ - word.size());
  }
  return *number;
}

double GmshCursor::take_text_real() {
  const std::string_view word = take_word();
  const std::optional<double> number = NumberText(word).take();
  if (!number) {
    fail(fmt::format("'{}' is not a number", word.substr(0, 60)), kSaveAgain,
         at_ - word.size());
  }
  return *number;
}

std::string_view GmshCursor::take_bytes(std::size_t n) {
  if (bytes_.size() - at_ < n) {
    fail("the file ends within a number", kCutShort, at_);
  }
  at_ += n;
  return bytes_.substr(at_ - n, n);
}

std::uint64_t GmshCursor::take_size() {
  if (!coding_.is_binary) {
    return take_text_count();
  }
  const std::string_view bytes = take_bytes(coding_.size_bytes);
  return coding_.size_bytes == 8 ? number_of<std::uint64_t>(bytes, coding_.order)
                                 : number_of<std::uint32_t>(bytes, coding_.order);
}

std::int64_t GmshCursor::take_int() {
  return coding_.is_binary ? number_of<std::int32_t>(take_bytes(4), coding_.order)
                           : take_text_integer();
}

double GmshCursor::take_real() {
  return coding_.is_binary ? number_of<double>(take_bytes(8), coding_.order) : take_text_real();
}

void GmshCursor::require_room(std::uint64_t n, const GmshItem& item,
                              std::string_view what) const {
  // As text a number takes two bytes, but for the last.
  const std::size_t left = bytes_.size() - at_;
  const std::size_t n_bytes =
      coding_.is_binary ? item.n_sizes * coding_.size_bytes + 4 * item.n_ints + 8 * item.n_reals
                        : 2 * (item.n_sizes + item.n_ints + item.n_reals);
  if (n > (left + 1) / n_bytes) {
    fail(fmt::format("{} {} in the {} bytes that are left", n, what, left), kCutShort, at_);
  }
}

}  // namespace haarlight::render
