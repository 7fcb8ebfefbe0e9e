// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "render/film/film.h"
#include "render/loop/tile_renderer.h"

/// @file
/// Which of several renderers of the same picture needs the least CPU time for an error: a pilot
/// renders patches of 8 x 8 of its own pixels, spread over it, with all of them.
///
/// What a renderer costs is v t: the variance of one sample, summed over the picture, times the CPU
/// time of a sample. Its efficiency, 1 / (error^2 x CPU time), is 1 / (v t) for any number of
/// samples. The patches are the same for all, so that what a patch shows cancels in the ratio of
/// two efficiencies; its standard error is that of the delete-one jackknife over patches
/// [Quenouille56], in logarithms.
///
/// All of it is random, and a path that is rare and bright may not have been seen at all: of what
/// fewer than one in n / 3 samples finds, n samples have found nothing with a probability of 5 %
/// or more. Then v is too small, and so is the number of samples that is predicted. A candidate that
/// finds such light otherwise tells of it (bidirectional path tracing of caustics).

namespace haarlight::render {

/// A renderer that may make the picture.
struct PilotCandidate {
  std::string name;
  /// What no number of samples takes off, a bound, relative L2. One with a bias is asked only where
  /// an error is requested that is twice as large.
  double bias = 0.0;
  std::vector<FilmLayer> layers;  ///< the first is RGB, with splats or not
  /// The number of the candidate with splats that tells of its samples by its own last layer, of two
  /// channels: a lower bound in the mean of their squares, and light that no candidate without splats
  /// ever meets, both summed over RGB. So light that is met by rare chance is known from paths that find
  /// it often.
  std::optional<std::size_t> told_by;
  /// @param seed  of its samples
  std::function<std::unique_ptr<TileRenderer>(std::uint64_t seed)> make;
};

struct PilotOptions {
  int width = 0;  ///< of the film
  int height = 0;
  std::uint64_t seed = 0;
  double relative_l2 = 0.0;  ///< RunOptions: 0: none is requested
  double seconds = std::numeric_limits<double>::infinity();  ///< of the pilot and the run
  /// Of the run's CPU time, that the pilot takes at most, but for its first round, and what it may
  /// always take.
  double share = 0.06;
  double free_seconds = 0.1;
};

/// What a pilot found of a candidate.
struct PilotScore {
  std::size_t patches = 0;        ///< 0: it was not asked
  double samples_for_unit = 0.0;  ///< for a relative L2 error of 1: error^2 x samples per pixel
  double sample_seconds = 0.0;    ///< CPU time of a sample of one pixel
  double efficiency = 0.0;  ///< over that of the first candidate, from the patches of both
  double log_error = 0.0;   ///< standard error of the logarithm of this
  /// Of the variance, what the samples of one pixel make: where it is large, the rest of the
  /// picture holds more such pixels, or none.
  double largest_share = 0.0;
  /// Its variance is a bound from another candidate's samples, which found light that its own met too
  /// rarely to know (PilotCandidate::told_by).
  bool is_told = false;
  double unmet =
      0.0;  ///< of the light, what it never meets: where that is known not to be little
};

struct PilotPrediction {
  double samples = 0.0;  ///< per pixel
  double factor =
      1.0;  ///< the interval is samples / factor to samples * factor: two standard errors
  std::uint32_t end = 0;  ///< when the run looks at its error next, and at least two
  double seconds = 0.0;   ///< of the run, on the threads that the pilot had
};

struct PilotResult {
  std::size_t chosen = 0;  ///< the first, unless another is better beyond two standard errors
  std::vector<PilotScore> scores;  ///< in the candidates' order
  std::optional<PilotPrediction>
      for_error;                        ///< where an error is requested, and can be predicted
  std::optional<double> error_in_time;  ///< where a time is given: relative L2, at its end
  bool is_black = false;                ///< no sample has found light: nothing is known
  bool is_doubtful =
      false;  ///< few pixels make the chosen one's variance, it is told by others, or
              ///< its samples are not known to a factor of two
  std::uint64_t samples = 0;  ///< of the chosen one, of all pixels together
  double seconds = 0.0;
  double cpu_seconds = 0.0;  ///< of the process
};

/// @param candidates  of one picture; the first is unbiased, and the one to take in doubt
[[nodiscard]] PilotResult run_pilot(std::span<const PilotCandidate> candidates,
                                    const PilotOptions& options);

/// What one patch showed of a candidate, summed over its pixels and channels.
struct PilotPatch {
  double variance = 0.0;  ///< of one sample
  double light = 0.0;  ///< squares of what its pixels' own samples show, less the noise's part
  double seconds = 0.0;        ///< CPU time
  double most_variance = 0.0;  ///< of one pixel
  int pixels = 0;
  std::size_t cell = 0;                                ///< of the picture, cut into patches
  Eigen::Vector3d radiance = Eigen::Vector3d::Zero();  ///< of its pixels' own samples
  double splats = 0.0;             ///< what its samples sent to any pixel, over all colours
  double squares_of_others = 0.0;  ///< of one sample: PilotCandidate::told_by
  double unmet = 0.0;              ///< light that others never meet
};

/// How much more efficient one is than another, from the same patches.
struct EfficiencyRatio {
  double logarithm = 0.0;
  double error = 0.0;  ///< standard; infinite of fewer than two patches
};
[[nodiscard]] EfficiencyRatio efficiency_ratio(std::span<const PilotPatch> one,
                                               std::span<const PilotPatch> other);

}  // namespace haarlight::render
