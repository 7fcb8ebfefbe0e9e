// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "haarlight/core/image.h"
#include "session/develop/lineariser.h"

/// @file
/// Predicts what the camera sees without light, at any exposure, time and temperature, from the
/// dark frames of a session:
///
///     D(pixel) = base(pixel) + slope(pixel) (m - mean m),    m = the frame's mean dark level
///
/// base and slope by least squares over all dark frames, so that their noise averages out; only
/// the single number m is interpolated: by time between the dark frames around a frame,
/// elsewhere by the controller's temperature, then linearly by exposure.

namespace haarlight::session {

class DarkModel {
 public:
  DarkModel() = default;
  /// @param darks  at least one; frames of one gain
  /// @throws Error  dark frames with different gains
  DarkModel(const Session& session, const std::vector<const FrameRecord*>& darks,
            const Lineariser& linear, const SensorResponse& response);

  [[nodiscard]] bool is_empty() const { return base_.is_empty(); }
  /// Mean dark level expected in a frame, in steps above black.
  /// @throws Error  a frame with a gain other than the dark frames'
  [[nodiscard]] double level_of(const Session& session, const FrameRecord& frame) const;
  /// The value to subtract from sample i at a level.
  [[nodiscard]] float at(std::size_t i, double level) const {
    const auto moved = static_cast<float>(level - mean_level_);
    return base_.pixels()[i] + (slope_.is_empty() ? moved : slope_.pixels()[i] * moved);
  }
  /// Its variance from the dark frames' own noise, steps^2; the same for all pixels.
  [[nodiscard]] double variance(double level) const;
  /// The picture at the highest level of any dark frame.
  [[nodiscard]] Image<float> brightest() const;

  [[nodiscard]] int n_frames() const { return static_cast<int>(points_.size()); }
  [[nodiscard]] double least_level() const;
  [[nodiscard]] double greatest_level() const;
  [[nodiscard]] int n_exposures() const;
  /// Each pixel has its own slope: the levels differ by more than half a step.
  [[nodiscard]] bool has_slope() const { return !slope_.is_empty(); }

 private:
  struct Point {
    double exposure_us = 0.0;
    std::int64_t time = 0;
    std::optional<double> temperature_c;
    double level = 0.0;
  };
  [[nodiscard]] double level_of_series(const std::vector<Point>& series, std::int64_t time,
                                       std::optional<double> temperature_c) const;

  Image<float> base_;
  Image<float> slope_;
  std::vector<Point> points_;  ///< by exposure, then time
  double gain_db_ = 0.0;
  double mean_level_ = 0.0;
  double sum_squares_ = 0.0;  ///< of the levels about their mean
  double pixel_variance_ = 0.0;
  bool is_black_known_ = false;
};

/// Time of a frame for interpolation: its exposure's start in ns, or its shot's number where
/// times are unknown (an import).
[[nodiscard]] std::int64_t time_of(const FrameRecord& frame);
/// As read back, otherwise as planned; 0: unknown.
[[nodiscard]] double exposure_us_of(const Session& session, const FrameRecord& frame);

}  // namespace haarlight::session
