// SPDX-License-Identifier: Apache-2.0
#include "relight/reflectance/formats/header_reader.h"

#include <charconv>
#include <cmath>

#include <fmt/format.h>

#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

constexpr std::size_t kLongestWord = 64;
constexpr std::size_t kLongestLine = 4096;
constexpr std::string_view kHint = "copy the file again, or make it again with its program";

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

}  // namespace

std::string location_in_file(const std::string& file, std::size_t offset) {
  return fmt::format("{}: byte {}", file, offset);
}

void HeaderReader::refuse_at(std::size_t offset, const std::string& what,
                             const std::string& hint) const {
  throw Error(what, location_in_file(where_, offset), hint);
}

void HeaderReader::refuse(const std::string& what) const {
  refuse_at(word_, what, std::string(kHint));
}

std::string_view HeaderReader::line() {
  word_ = at_;
  const std::size_t end = bytes_.substr(at_, kLongestLine).find('\n');
  if (end == std::string_view::npos) {
    refuse("the header ends within a line");
  }
  std::string_view text = bytes_.substr(at_, end);
  at_ += end + 1;
  while (!text.empty() && is_blank(text.back())) {
    text.remove_suffix(1);
  }
  return text;
}

std::string_view HeaderReader::word() {
  while (!is_at_end() && (is_blank(peek()) || peek() == '\n')) {
    ++at_;
  }
  word_ = at_;
  while (!is_at_end() && !is_blank(peek()) && peek() != '\n') {
    if (at_ - word_ >= kLongestWord) {
      refuse("not a number: too long");
    }
    ++at_;
  }
  if (at_ == word_) {
    refuse("the header ends too early");
  }
  return bytes_.substr(word_, at_ - word_);
}

double HeaderReader::number(double min, double max, std::string_view what) {
  std::string_view text = word();
  if (text.size() > 1 && text.front() == '+') {
    text.remove_prefix(1);
  }
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    refuse(fmt::format("the {} is not a finite number", what));
  }
  if (value < min || value > max) {
    refuse(fmt::format("the {} is {:g}, outside {:g} to {:g}", what, value, min, max));
  }
  return value;
}

std::int64_t HeaderReader::integer(std::int64_t min, std::int64_t max, std::string_view what) {
  std::string_view text = word();
  if (text.size() > 1 && text.front() == '+') {
    text.remove_prefix(1);
  }
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) {
    refuse(fmt::format("the {} is not a whole number", what));
  }
  if (value < min || value > max) {
    refuse(fmt::format("the {} is {}, outside {} to {}", what, value, min, max));
  }
  return value;
}

void HeaderReader::end_of_header() {
  while (!is_at_end() && is_blank(peek())) {
    ++at_;
  }
  word_ = at_;
  if (peek() != '\n' || is_at_end()) {
    refuse("the header does not end with its line");
  }
  ++at_;
}

}  // namespace haarlight::relight
