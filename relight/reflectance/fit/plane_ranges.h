// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// From 16-bit plane values to 8 bits with little loss: for every plane the range with the
/// least squared error, from clipping at its ends and from the 255 steps between them. Pure.

namespace haarlight::relight {

/// 16-bit codes of a plane: value = low + code * step.
struct PlaneCodes {
  double low = 0.0;
  double step = 1.0 / 65535.0;
};

/// Histogram of a plane's codes, sixteen codes per bin.
class PlaneHistogram {
 public:
  static constexpr std::size_t kBins = 4096;
  PlaneHistogram() : counts_(kBins), quarters_(4 * kBins) {}
  /// At most 2^34 codes in all.
  void add(std::span<const std::uint16_t> codes);
  /// Adds a plane that must share the range. Both histograms have the same PlaneCodes.
  void add(const PlaneHistogram& other);
  [[nodiscard]] std::vector<std::uint64_t> counts() const;

 private:
  std::vector<std::uint64_t> counts_;  ///< from other histograms
  /// Four counters per bin, in turn: neighbouring values are alike, and none waits for the
  /// other's update.
  std::vector<std::uint32_t> quarters_;
};

/// How ends are chosen.
enum class RangeEnds {
  least_error,  ///< clip what costs less than the coarser steps it would need
  extremes,     ///< nothing is clipped
};

struct PlaneRange {
  PlaneScale scale;
  double rms_error = 0.0;  ///< expected, of the plane's values
  double clipped = 0.0;    ///< fraction of values outside
};

/// @param rule  what the file's numbers can express (haarlight/relight/reflectance/formats/quantise.h):
///              .ptm requires 0 to be exactly a byte
[[nodiscard]] PlaneRange choose_range(const PlaneHistogram& histogram, const PlaneCodes& codes,
                                      RangeEnds ends, ScaleRule rule = ScaleRule::any);

}  // namespace haarlight::relight
