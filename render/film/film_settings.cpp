// SPDX-License-Identifier: Apache-2.0
#include "haarlight/render/film/film_settings.h"

#include <charconv>
#include <system_error>

#include <fmt/format.h>

namespace haarlight::render {

std::optional<Crop> parse_crop(std::string_view text) {
  Crop crop;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  const auto number = [&](int& value, char before) {
    if (before != '\0' && (at == end || *at++ != before)) {
      return false;
    }
    const auto [last, problem] = std::from_chars(at, end, value);
    at = last;
    return problem == std::errc() && value >= 0;
  };
  const bool is_read = number(crop.width, '\0') && number(crop.height, 'x') &&
                       number(crop.x, '+') && number(crop.y, '+') && at == end;
  return is_read && crop.width > 0 && crop.height > 0 ? std::optional(crop) : std::nullopt;
}

std::string crop_text(const Crop& crop) {
  return fmt::format("{}x{}+{}+{}", crop.width, crop.height, crop.x, crop.y);
}

bool is_within(const Crop& crop, int width, int height) noexcept {
  return crop.x >= 0 && crop.y >= 0 && crop.width <= width - crop.x &&
         crop.height <= height - crop.y;
}

}  // namespace haarlight::render
