// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "haarlight/core/tolerance.h"
#include "haarlight/relight/basis/basis_file.h"
#include "haarlight/relight/basis/relight.h"
#include "relight/pipeline/clipped_words.h"
#include "relight/pipeline/light_choice.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/pipeline/relight_choice.h"

/// @file
/// From a basis file to a picture under an environment, chosen lights or a list of light
/// weights, with a bound on its error; or to an animation, the environment turning once.
/// Method: haarlight/relight/basis/relight.h, docs/numerics/relight.md.

namespace haarlight::relight {

struct RelightPictureOptions {
  std::string basis;
  std::string output;  ///< picture: .exr linear, .png for display; of frames OUT-0000 ...
  LightChoice light;
  std::string weights;              ///< JSON list of every light's weight; empty: none
  std::optional<double> max_error;  ///< bound on the relative L2 error, in the least time
  std::optional<int> terms;         ///< nothing: all
  std::optional<double> seconds;    ///< of a picture's sum: the least error in that time
  std::optional<RelightForm> form;  ///< with either: instead of the one predicted to be best
  TermOrder order = TermOrder::transport;
  std::optional<double> exposure;  ///< default: 99.5th percentile white for .png
  double stops = 0.0;              ///< that factor, brighter or darker
  std::string against;             ///< session of the same capture; empty: none
  std::optional<int> frames;       ///< that many while the environment turns once
  PipelineSettings settings;
};

struct RelightSummary {
  BasisHeader basis;
  std::optional<double> missing_fraction;  ///< of an environment; the worst frame's
  double conservation_error = 0.0;         ///< of the same
  std::string layout;                      ///< of the environment; empty: none
  double relative_l2_bound = 0.0;          ///< the worst frame's, as all below
  std::vector<double> channel_bounds;      ///< (channels)
  PictureClipping clipping;
  int terms = 0;
  std::vector<int> picture_terms;  ///< of each picture
  int terms_all = 0;               ///< of one picture
  double seconds = 0.0;            ///< of relighting alone: choosing, unpacking, sums, bounds
  double cpu_seconds = 0.0;        ///< of the same, all threads
  std::uint64_t bytes_read = 0;    ///< of one picture
  std::string method;              ///< of frames
  double exposure = 1.0;
  std::optional<Achieved> against;  ///< the session
  bool is_error_kept = true;        ///< the bound is at most max_error, if that was requested
  bool is_time_enough = true;       ///< some way was predicted to take at most that long
  std::optional<RelightChoice> choice;  ///< for a requested error or time
  std::uint64_t bytes = 0;              ///< of the pictures
  std::vector<PipelineNote> notes;      ///< all messages
};

/// One picture, or options.frames.
/// @throws Error(usage)  not one light, frames without an environment
/// @throws Error  inputs that cannot be read or do not belong together, outputs that exist
[[nodiscard]] RelightSummary relight_picture(const RelightPictureOptions& options);

/// What was requested and achieved.
void add_to_report(const RelightPictureOptions& options, const RelightSummary& summary,
                   Report& report);

}  // namespace haarlight::relight
