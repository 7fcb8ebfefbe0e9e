// SPDX-License-Identifier: Apache-2.0
#include "render/cell_mesh/mesh_numbers.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstring>
#include <limits>
#include <system_error>

namespace haarlight::render {

namespace {

template <class T>
void append(std::string_view bytes, std::endian order, std::vector<double>& values) {
  const std::size_t n = bytes.size() / sizeof(T);
  values.reserve(values.size() + n);
  for (std::size_t i = 0; i < n; ++i) {
    std::array<char, sizeof(T)> number{};
    std::memcpy(number.data(), bytes.data() + i * sizeof(T), sizeof(T));
    if (order != std::endian::native) {
      std::reverse(number.begin(), number.end());
    }
    values.push_back(static_cast<double>(std::bit_cast<T>(number)));
  }
}

bool is_space(char c) {
  return c == ' ' || c == '\n' || c == '\r' || c == '\t' || c == '\v' || c == '\f';
}

}  // namespace

std::size_t size_of(NumberType type) {
  constexpr std::array<std::size_t, 10> kSizes = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return kSizes.at(static_cast<std::size_t>(type));
}

void append_numbers(std::string_view bytes, NumberType type, std::endian order,
                    std::vector<double>& values) {
  switch (type) {
    case NumberType::i8:
      return append<std::int8_t>(bytes, order, values);
    case NumberType::u8:
      return append<std::uint8_t>(bytes, order, values);
    case NumberType::i16:
      return append<std::int16_t>(bytes, order, values);
    case NumberType::u16:
      return append<std::uint16_t>(bytes, order, values);
    case NumberType::i32:
      return append<std::int32_t>(bytes, order, values);
    case NumberType::u32:
      return append<std::uint32_t>(bytes, order, values);
    case NumberType::i64:
      return append<std::int64_t>(bytes, order, values);
    case NumberType::u64:
      return append<std::uint64_t>(bytes, order, values);
    case NumberType::f32:
      return append<float>(bytes, order, values);
    case NumberType::f64:
      return append<double>(bytes, order, values);
  }
}

bool NumberText::is_at_end() {
  while (at_ < text_.size() && is_space(text_[at_])) {
    ++at_;
  }
  return at_ == text_.size();
}

std::optional<double> NumberText::take() {
  if (is_at_end()) {
    return std::nullopt;
  }
  const char* begin = text_.data() + at_;
  const char* const limit = text_.data() + text_.size();
  begin += *begin == '+' ? 1 : 0;
  double value = 0.0;
  const auto [end, problem] = std::from_chars(begin, limit, value);
  if (problem == std::errc::result_out_of_range) {
    // Too small for a double is 0, as others read it; too large is no number.
    const std::string_view number(begin, static_cast<std::size_t>(end - begin));
    if (number.find("e-") == std::string_view::npos &&
        number.find("E-") == std::string_view::npos) {
      return std::nullopt;
    }
    value = 0.0;
  } else if (problem != std::errc()) {
    return std::nullopt;
  }
  if (end != limit && !is_space(*end)) {
    return std::nullopt;
  }
  at_ = static_cast<std::size_t>(end - text_.data());
  return value;
}

}  // namespace haarlight::render
