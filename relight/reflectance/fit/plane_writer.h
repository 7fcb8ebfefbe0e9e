// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "haarlight/relight/reflectance/formats/reflectance.h"
#include "relight/reflectance/fit/plane_ranges.h"
#include "relight/reflectance/fit/plane_store.h"

/// @file
/// Takes a fit's planes as 16-bit codes band by band, and converts them to the model's bytes
/// when all are in and their ranges are known.

namespace haarlight::relight {

struct PlaneOptions {
  ScaleRule rule = ScaleRule::any;  ///< of the file that the planes are for
  RangeEnds ends = RangeEnds::least_error;
  /// 16-bit planes beyond this go to an unnamed temporary file in `work_folder`.
  std::uint64_t memory_bytes = std::uint64_t{1} << 29U;
  std::filesystem::path work_folder = std::filesystem::temp_directory_path();
};

struct FitResult {
  ReflectanceModel model;
  double quantisation_rms = 0.0;  ///< expected, of the planes' values
  double clipped = 0.0;           ///< fraction of plane values beyond the chosen ranges
};

class PlaneWriter {
 public:
  /// @param codes  one per plane, in the model's order
  /// @throws Error(io)  no disk space for 16-bit planes
  PlaneWriter(int width, int height, std::vector<PlaneCodes> codes,
              const PlaneOptions& options);
  [[nodiscard]] std::size_t n_planes() const noexcept { return codes_.size(); }
  [[nodiscard]] const std::vector<PlaneCodes>& codes() const noexcept { return codes_; }

  /// Where the next rows' codes go, (n_rows, n_planes, width).
  [[nodiscard]] std::span<std::uint16_t> next_rows(std::size_t n_rows);
  /// A plane at some pixels, values + added, as codes. Values beyond the codes' range are
  /// clamped.
  void encode(std::size_t plane, std::span<const float> values, double added,
              std::uint16_t* codes) const;
  /// The same for three planes, `apart` from each other and with the same PlaneCodes, whose
  /// values are interleaved: R, G, B pixel by pixel.
  /// @param codes  the first plane's, of a row as in next_rows()
  void encode_threes(std::size_t plane, std::size_t apart, std::span<const float> values,
                     double added, std::uint16_t* codes) const;
  /// The rows from next_rows() have been filled.
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
  std::span<std::uint16_t> rows_;  ///< returned by next_rows()
};

}  // namespace haarlight::relight
