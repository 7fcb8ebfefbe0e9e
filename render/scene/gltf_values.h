// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <string_view>

#include <fmt/format.h>

#include "core/json_value.h"

/// @file
/// Values of a glTF file that may be absent, within limits.

namespace haarlight::render {

struct GltfRange {
  double min = -1e30;
  double max = 1e30;
};

inline double number_or(const JsonValue& json, std::string_view key, double fallback,
                        const GltfRange& range = {}) {
  return json.has(key) ? json[key].number(range.min, range.max) : fallback;
}

/// @throws Error  other than N numbers
template <std::size_t N>
std::array<double, N> numbers_or(const JsonValue& json, std::string_view key,
                                 std::array<double, N> fallback, const GltfRange& range = {}) {
  if (!json.has(key)) {
    return fallback;
  }
  const std::vector<JsonValue> list = json[key].elements();
  if (list.size() != N) {
    json[key].refuse(fmt::format("{} numbers, where there are {}", list.size(), N),
                     "export the scene again, or hold it to the glTF validator");
  }
  for (std::size_t i = 0; i < N; ++i) {
    fallback[i] = list[i].number(range.min, range.max);
  }
  return fallback;
}

/// "materials[2]", without the file's name.
inline std::string place_of(const JsonValue& json, const std::string& file) {
  const std::string& location = json.location();
  return location.starts_with(file + ": ") ? location.substr(file.size() + 2) : location;
}

}  // namespace haarlight::render
