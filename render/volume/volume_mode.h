// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>

#include "haarlight/core/enum_words.h"

/// @file
/// The exact way to integrate along rays, and the named rules that it is compared with.

namespace haarlight::render {

enum class VolumeMode : std::uint8_t {
  exact,
  gauss,        ///< n points on pieces of an optical depth of at most tau
  series,       ///< a power series with a guaranteed bound, after [Novins92]
  paper,        ///< [Williams98]: its Dawson's and error integrals; 5 points where fields bend
  approximate,  ///< [Williams98], section 4: the mean colour of a piece's ends times its opacity
  approximate_unsliced,  ///< the same of whole cells, not cut at breakpoints
};
inline constexpr auto kVolumeModeWords = std::to_array<std::string_view>(
    {"exact", "gauss", "series", "paper", "approximate", "approximate-unsliced"});
constexpr std::span<const std::string_view> words_of(VolumeMode) { return kVolumeModeWords; }

struct VolumeRule {
  VolumeMode mode = VolumeMode::exact;
  int points = 5;            ///< of mode gauss, 1..kMostPoints
  double piece_depth = 0.5;  ///< of mode gauss, 1e-6..1e3
  /// Of mode series: what it may be off by, of a segment's opacity times its largest colour; below
  /// 1e-16 as 1e-16.
  double tolerance = 0.0;

  static constexpr int kMostPoints = 32;
  static constexpr double kLeastPieceDepth = 1e-6;
  static constexpr double kLargestPieceDepth = 1e3;
};

}  // namespace haarlight::render
