// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/image.h"

/// @file
/// Filters of a rendered picture, after any integrator: less noise for a bias, what is near is mixed
/// [McCool99]. All keep the sum of each channel [Rushmeier94], and a picture of one value stays as it is:
/// pixels p and q exchange w_pq (c_q - c_p), with one weight both ways.
///
/// Pure; the same for any number of threads.

namespace haarlight::render {

enum class SmoothingKind : std::uint8_t {
  low_pass,  ///< the mean over 3 x 3
  median,    ///< the median of 3 x 3; what it takes from a pixel is spread over these 3 x 3
  features   ///< what looks like the same surface: by normals, depths and albedos
};
inline constexpr auto kSmoothingWords =
    std::to_array<std::string_view>({"low-pass", "median", "features"});
constexpr std::span<const std::string_view> words_of(SmoothingKind) { return kSmoothingWords; }

/// What a pixel shows first, (h, w, 3 or 1); means over the pixel.
struct PictureFeatures {
  ImageView<const float> albedo;
  ImageView<const float> normal;
  ImageView<const float> depth;  ///< mm; kNoDepth where nothing is seen
  ImageView<const float> error;  ///< standard error of the picture; empty: not known
};

struct SmoothingOptions {
  SmoothingKind kind = SmoothingKind::features;
  int radius = 5;       ///< of `features`: (2 r + 1)^2 pixels take part
  double normal = 0.2;  ///< of `features`: differences of these sizes count e^-1/2
  double depth = 0.02;  ///< of the depth, for each pixel of distance
  double albedo = 0.05;
  double colour = 3.0;  ///< in standard errors of the difference, where they are known
};

/// @param picture   (h, w, channels), finite
/// @param features  of the same size; used by `features` alone
[[nodiscard]] Image<float> smooth(ImageView<const float> picture,
                                  const PictureFeatures& features,
                                  const SmoothingOptions& options);

}  // namespace haarlight::render
