// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/rig/measured_rig.h"
#include "haarlight/core/image.h"

/// @file
/// A camera's noise from pairs of pictures of the same light: the photon transfer method as
/// [Emva21] describes it, with the pixels sorted by their level, so that the light need not be
/// uniform. Pure. Notes and measured errors: docs/numerics/commissioning.md.
///
///     variance(level) = variance(dark) + (level - black) / K        K: electrons per count
///
/// The difference of two consecutive pictures has twice the temporal variance and none of the
/// fixed pattern. Rounding adds 1/12 count^2, which is subtracted from the read noise.

namespace haarlight::capture {

/// Pixel pairs of similar level. Mergeable: sums only.
struct TransferBin {
  double degrees = 0.0;     ///< of freedom of the variance
  double sum_square = 0.0;  ///< degrees * variance, counts^2
  double n = 0.0;           ///< pixel pairs
  double sum_level = 0.0;   ///< counts
  [[nodiscard]] double level() const { return sum_level / n; }
  [[nodiscard]] double variance() const { return sum_square / degrees; }
};

/// Collects pairs, 128 levels. One thread.
class TransferCurve {
 public:
  /// @param white  2^bits - 1; pairs that touch 0 or white are ignored
  explicit TransferCurve(int white);
  /// Two consecutive pictures of the same light and exposure, `rows` rows of each.
  void add_pair(ImageView<const std::uint16_t> first, ImageView<const std::uint16_t> second,
                int rows);
  [[nodiscard]] const std::vector<TransferBin>& bins() const { return bins_; }

 private:
  int white_;
  std::vector<TransferBin> bins_;
  std::vector<double> scratch_;
};

/// Level and temporal noise of dark pictures.
struct DarkLevel {
  double mean_dn = 0.0;
  double variance_dn2 = 0.0;
  double degrees = 0.0;
  double clipped_fraction = 0.0;  ///< of pixels at 0: above 1e-3 the noise cannot be trusted
  double n = 0.0;                 ///< pixel pairs
};
void add_dark_pair(ImageView<const std::uint16_t> first, ImageView<const std::uint16_t> second,
                   int rows, DarkLevel& dark);

/// Where the signal stops growing: two pictures far beyond it, the second exposed longer.
/// @param ratio  of the exposures, above 1.2
/// @return  the level in counts; nothing when fewer than 50 pixels stay constant
[[nodiscard]] std::optional<double> find_saturation(ImageView<const std::uint16_t> shorter,
                                                    ImageView<const std::uint16_t> longer,
                                                    int rows, double ratio, double black_dn);

/// Mean level of the same pixels at one exposure.
struct ExposureLevel {
  double exposure_us = 0.0;
  double mean_dn = 0.0;
};

struct SensorMeasurement {
  Measured gain_e_per_dn;
  Measured read_e;
  Measured black_dn;
  std::optional<Measured> full_well_e;  ///< nothing: saturation out of reach
  std::optional<Measured> linearity_percent;
  bool is_converter_limited = false;  ///< white was achieved before the full well
  bool is_read_from_curve = false;    ///< dark pixels clip at 0: read noise taken from the fit
  double dark_variance_dn2 = 0.0;     ///< the fit's value at black
  double reduced_chi2 = 0.0;          ///< of the fit, 1 = only counting noise
};

/// @param saturation_dn  from find_saturation
/// @return  nothing when fewer than 4 levels hold enough pairs
[[nodiscard]] std::optional<SensorMeasurement> measure_sensor(
    const TransferCurve& curve, const DarkLevel& dark, std::optional<double> saturation_dn,
    int white, std::span<const ExposureLevel> levels);

}  // namespace haarlight::capture
