// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "haarlight/core/image.h"
#include "haarlight/relight/reflectance/formats/reflectance.h"

/// @file
/// Coefficients to bytes, one linear scale per plane: first the ranges over all rows, then
/// scales by the rules of the target file, then the rows again.

namespace haarlight::relight {

/// What a file's scales can express.
enum class ScaleRule {
  any,  ///< a scale above 0 and an offset per plane (Relight's web folder)
  rti,  ///< one pair of 32-bit floats per term, shared by R, G and B
  ptm,  ///< one scale of 6 decimals and one integer bias 0..255 per term, shared by R, G
        ///< and B; the three colour planes of lrgb are plain bytes, 0..1
};

/// The smallest and largest value of each plane; a plane without samples is [0, 0].
class PlaneRanges {
 public:
  explicit PlaneRanges(int n_planes);
  /// @param samples  pixel by pixel, n_planes each
  /// @throws Error  a value is not a finite number
  void add(std::span<const float> samples);
  void merge(const PlaneRanges& other);
  [[nodiscard]] int n_planes() const noexcept { return static_cast<int>(min_.size()); }
  [[nodiscard]] double min(int plane) const noexcept;
  [[nodiscard]] double max(int plane) const noexcept;

 private:
  std::vector<float> min_;
  std::vector<float> max_;
};

/// Scales that hold the ranges in bytes 0..255 without clipping (except for the colours of lrgb
/// in a .ptm, which are 0..1). No scale is 0: other readers divide by it.
[[nodiscard]] std::vector<PlaneScale> choose_scales(const PlaneRanges& ranges,
                                                    ReflectanceColour colour, int n_terms,
                                                    ScaleRule rule = ScaleRule::any);

/// A scale rounded to a rule's numbers: as the file would hold it.
struct PtmScale {
  double scale = 1.0;  ///< in 255ths, 6 decimals
  int bias = 0;        ///< 0..255
};
/// True if the rule can express the scales exactly: then a file holds the model unchanged.
[[nodiscard]] bool obeys(ScaleRule rule, const ReflectanceModel& model);
/// A plane's scale as that of a .ptm's term; exact if obeys(ptm).
[[nodiscard]] PtmScale ptm_scale(const PlaneScale& scale) noexcept;

/// Nearest bytes of one row (or any number of pixels), clipped to 0..255.
/// @param samples  pixel by pixel, one value per scale
/// @param bytes    as many
void quantise_row(std::span<const float> samples, std::span<const PlaneScale> scales,
                  std::span<std::uint8_t> bytes);

/// The same picture with scales that the rule can express: if they already are, nothing
/// changes. Every value moves by at most half a new step. For .ptm, colours of lrgb beyond 0..1
/// are divided by their largest value, and the luminance multiplied by it.
/// @throws Error  lrgb with colours below 0, which a .ptm cannot hold
[[nodiscard]] ReflectanceModel with_scales_of(ScaleRule rule, ReflectanceModel model);

}  // namespace haarlight::relight
