#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "relight/fit/plane_ranges.h"
#include "relight/fit/plane_store.h"
#include "relight/formats/reflectance.h"

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

  /// Values of a plane at some pixels, as codes. Values beyond the codes' range stop there.
  void encode(std::size_t plane, std::span<const float> values, std::uint16_t* codes) const;
  /// The next rows. @param lines  (n_rows, n_planes, width)
  void append(std::span<const std::uint16_t> lines);
  /// @param model  basis, colour, terms, transfer: gets planes and scales
  [[nodiscard]] FitResult finish(ReflectanceModel model);

 private:
  std::size_t width_;
  std::size_t height_;
  std::vector<PlaneCodes> codes_;
  PlaneOptions options_;
  PlaneStore store_;
  std::vector<PlaneHistogram> histograms_;
};

}  // namespace haarlight
