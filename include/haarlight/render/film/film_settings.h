// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "haarlight/core/enum_words.h"

/// @file
/// What a scene file's [film] says of the picture that is made of it: size, crop, filter.

namespace haarlight::render {

/// How a pixel weighs what is around its centre: render/film/filter.h.
enum class FilterKind : std::uint8_t {
  box,       ///< the pixel
  gaussian,  ///< deviation 0.5 pixels, cut at 1.5 and lowered to 0 there
  mitchell,  ///< B = C = 1/3, radius 2 [Mitchell88]; negative lobes
};
inline constexpr auto kFilterWords =
    std::to_array<std::string_view>({"box", "gaussian", "mitchell"});
constexpr std::span<const std::string_view> words_of(FilterKind) { return kFilterWords; }

/// So many pixels of a picture across and down, from column x and row y on, counted from 0.
struct Crop {
  int width = 0;
  int height = 0;
  int x = 0;
  int y = 0;

  friend bool operator==(const Crop&, const Crop&) = default;
};

/// "640x480+100+50". @return nothing where it has another form or no pixels
[[nodiscard]] std::optional<Crop> parse_crop(std::string_view text);
[[nodiscard]] std::string crop_text(const Crop& crop);

/// Whether all its pixels are some of a picture of that size.
[[nodiscard]] bool is_within(const Crop& crop, int width, int height) noexcept;

/// Nothing: not said.
struct FilmSettings {
  std::optional<std::array<int, 2>> size;  ///< width, height; else the camera's
  std::optional<Crop> crop;                ///< of that size; else the whole picture
  std::string crop_where;  ///< file:line, for errors: another size may be requested
  std::optional<FilterKind> filter;
};

}  // namespace haarlight::render
