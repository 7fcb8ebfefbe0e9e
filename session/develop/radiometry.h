// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <string>
#include <utility>
#include <vector>

#include "haarlight/session/develop/develop_options.h"
#include "session/develop/drift_model.h"
#include "session/develop/exposure_plan.h"
#include "session/develop/flat_field.h"
#include "session/develop/radiance_row.h"
#include "session/frame_reader.h"

/// @file
/// From a session's raw frames to linear radiance, pattern by pattern: the steps of develop
/// before demultiplexing and demosaicing. Each step can be disabled by name, and what each did
/// is reported as JSON.

namespace haarlight::session {

/// The level of a longer exposure against the prediction from the one before it, over samples
/// selected by their neighbours of the same colour: whether a sample counts is independent of
/// its own noise.
struct LevelPair {
  double sum_longer = 0.0;
  double sum_predicted = 0.0;
  double var_longer = 0.0;  ///< of the sums, from photon and read noise
  double var_predicted = 0.0;
  [[nodiscard]] double ratio() const { return sum_longer / sum_predicted; }
  /// Standard error of ratio().
  [[nodiscard]] double sigma() const;
};

/// Counted while pictures are computed; summed over bands and patterns.
struct MergeTally {
  std::uint64_t n_pixels = 0;     ///< samples of all patterns
  std::uint64_t n_saturated = 0;  ///< clipped in every exposure
  std::uint64_t n_compared = 0;   ///< samples with two or more unclipped exposures
  std::uint64_t n_moved = 0;      ///< of these: exposures that contradict each other (6 sigma)
  std::map<std::pair<double, double>, LevelPair> levels;  ///< by the exposures' scales
  void add(const MergeTally& other);
};

/// Rows of one pattern.
struct RadianceRows {
  Image<float> value;  ///< radiance at unit exposure, gain (and drive, power where single)
  /// Of it; -1 where clipped in every exposure: a lower bound. Empty unless requested.
  Image<float> variance;
  Image<std::uint8_t> clipped;  ///< 1 where clipped in every exposure; empty: nowhere
  MergeTally tally;
};

/// Marks of (rows, width, channels), 1 where the variance is that of a lower bound; empty if
/// there are none.
[[nodiscard]] Image<std::uint8_t> clipped_marks(const Image<float>& variance);

/// All corrections of one session, measured once. Safe to share between threads (const calls).
class Radiometry {
 public:
  /// @throws Error  as its parts; drift beyond max_drift
  Radiometry(const Session& session, const ExposurePlan& plan, Transfer transfer,
             RadiometryOptions options);

  /// Rows [y0, y1) of the active area under one pattern. Only rows [count_from, count_to) of
  /// the picture are counted in the tally.
  struct Rows {
    int y0 = 0;
    int y1 = 0;
    int count_from = 0;
    int count_to = 0;
    /// The pattern is one of many to be combined: its variance excludes the noise that it has
    /// in common with the others, the dark model's and the flat field's.
    bool is_combined = false;
    bool has_variance = false;  ///< it is requested
  };
  /// @param out  what it holds is overwritten; its memory is used again
  /// @throws Error  a sample that is not a finite number, a frame that cannot be read
  void measure(const PatternGroup& group, const Rows& rows, RadianceRows& out) const;
  /// Says that rows [y0, y1) of a pattern will be measured soon.
  void expect(const PatternGroup& group, int y0, int y1) const noexcept;

  /// @throws Error  an exposure whose level contradicts the others by more than max_level_error
  /// and 5 standard errors of the ratio
  void require_levels(const MergeTally& tally) const;

  /// Standard deviation of a pattern's radiance due to the dark model's own noise, the same in
  /// every pattern of these exposures. With several exposures: of the longest, which weighs
  /// most where dark noise matters (an approximation: the others weigh less and have more).
  [[nodiscard]] double dark_sigma(const PatternGroup& group) const;
  /// Relative variance of the flat field: at a pixel the same for every pattern.
  [[nodiscard]] double flat_variance() const { return flat_.relative_variance; }

  /// The size of one camera step in the radiance of a frame's pattern, without the flat field;
  /// 0 where the curve is not linear, or channels have gains of their own.
  [[nodiscard]] double step_of(const ScaledFrame& frame) const;

  /// True when some pixel is bad: inpainting then needs rows around a band.
  [[nodiscard]] bool has_bad_pixels() const { return !bad_.is_empty(); }
  [[nodiscard]] const SensorResponse& response() const { return response_; }
  /// What each step did, as a JSON object.
  [[nodiscard]] std::string record(const MergeTally& tally) const;

 private:
  struct Factors;
  void measure_flat_field(const ExposurePlan& plan, Transfer transfer);
  [[nodiscard]] Factors factors_of(const ScaledFrame& frame) const;
  struct StripRow;
  void compare_levels(const StripRow& row, std::vector<LevelPair>& levels) const;
  /// As stored: not linearised, black not subtracted.
  [[nodiscard]] Image<float> read_rows(const FrameRecord& frame, int y0, int y1) const;
  void measure_strip(const PatternGroup& group, const Rows& rows, int y0, int y1,
                     RadianceRows& out) const;
  /// A pattern of one exposure without variances, in vectors: the same values.
  void measure_single(const ScaledFrame& frame, const Rows& rows, RadianceRows& out) const;
  struct RowBuffers;
  void measure_row(const ScaledFrame& frame, int y, const FrameScale& scale, double dark_level,
                   RowBuffers& row) const;

  const Session* session_;
  FrameReader reader_;
  RadiometryOptions options_;
  SensorResponse response_;
  Lineariser linear_;
  DarkModel dark_;
  FlatField flat_;
  DriftModel drift_;
  BadPixelMap bad_;
  int n_ignored_sentinels_ = 0;
};

}  // namespace haarlight::session
