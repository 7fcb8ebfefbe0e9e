// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/picture/picture_formats.h"
#include "haarlight/core/image.h"
#include "haarlight/core/picture/image_io.h"

/// @file
/// From the numbers of a picture file to linear light of Rec. 709 primaries, where the file
/// says that they are not sRGB.

namespace haarlight {

/// Immutable; safe from any thread.
class ColourConversion {
 public:
  ColourConversion() = default;
  ColourConversion(const ColourConversion&) = delete;
  ColourConversion& operator=(const ColourConversion&) = delete;
  virtual ~ColourConversion() = default;

  /// In place; colours outside Rec. 709's triangle get negative components.
  /// @param pixels  one pixel after another, `channels` (1 or 3) numbers each
  virtual void to_linear(std::span<float> pixels, int channels) const = 0;
};

struct PictureColours {
  Transfer transfer = Transfer::srgb;  ///< what applies where there is no conversion
  std::shared_ptr<const ColourConversion> conversion;
  std::string name;
};

/// A profile that is everywhere within half an 8-bit code of sRGB, or of linear light, is
/// treated as such: its picture gets the same values as one without a profile.
/// @throws Error  the profile is damaged, for inks (CMYK), or a grey one in a colour picture
[[nodiscard]] PictureColours colours_of(const PictureSource& source,
                                        const PictureContent& content);

/// An ICC profile of linear light with Rec. 709 primaries (grey: 1 channel); no date.
[[nodiscard]] std::vector<std::byte> linear_profile(int channels);

}  // namespace haarlight
