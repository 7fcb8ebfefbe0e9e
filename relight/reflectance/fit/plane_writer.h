// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "relight/reflectance/fit/plane_ranges.h"
#include "relight/reflectance/fit/plane_store.h"
#include "relight/reflectance/formats/reflectance.h"

/// @file
/// Takes a fit's planes as 16-bit codes band by band, and makes the model's bytes of them when
/// all are there and their ranges are known.

namespace haarlight {

struct PlaneOptions {
  ScaleRule rule = ScaleRule::any;  ///< of the file that the planes are for
  RangeEnds ends = RangeEnds::least_error;
  /// 16-bit planes beyond this go to a nameless file in `work_folder`.
  std::uint64_t memory_bytes = std::uint64_t{1} << 29U;
  std::filesystem::path work_folder = std::filesystem::temp_directory_path();
};

struct FitResult {
  ReflectanceModel model;
  double quantisation_rms = 0.0;  ///< of the planes' values, expected
  double clipped = 0.0;           ///< share of plane values beyond the chosen ranges
};

class PlaneWriter {
 public:
  /// @param codes  a plane, in the model's order
  /// @throws Error(io)  no room for 16-bit planes
  PlaneWriter(int width, int height, std::vector<PlaneCodes> codes,
              const PlaneOptions& options);
  [[nodiscard]] std::size_t n_planes() const noexcept { return codes_.size(); }
  [[nodiscard]] const std::vector<PlaneCodes>& codes() const noexcept { return codes_; }

  /// Where the next rows' codes go, (n_rows, n_planes, width).
  [[nodiscard]] std::span<std::uint16_t> next_rows(std::size_t n_rows);
  /// A plane at some pixels, values + added, as codes. What is beyond the codes' range stops
  /// there.
  void encode(std::size_t plane, std::span<const float> values, double added,
              std::uint16_t* codes) const;
  /// The same of three planes, `apart` each from the next and of the same PlaneCodes, whose
  /// values stand side by side: R, G, B pixel by pixel.
  /// @param codes  the first plane's, of a row as in next_rows()
  void encode_threes(std::size_t plane, std::size_t apart, std::span<const float> values,
                     double added, std::uint16_t* codes) const;
  /// What next_rows() gave is filled.
  void append();
  /// @param model  basis, colour, terms, transfer: gets planes and scales
  [[nodiscard]] FitResult finish(ReflectanceModel model);

 private:
  std::size_t width_;
  std::size_t height_;
  std::vector<PlaneCodes> codes_;
  PlaneOptions options_;
  PlaneStore store_;
  std::vector<PlaneHistogram> histograms_;
  std::span<std::uint16_t> rows_;  ///< given out by next_rows()
};

}  // namespace haarlight
