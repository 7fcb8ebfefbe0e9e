// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/report.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/core/stack/light_stack.h"
#include "haarlight/session/develop/develop.h"
#include "relight/pipeline/pipeline_settings.h"

/// @file
/// A session's raw frames to the light stack (haarlight/session/develop/develop.h), which stays
/// in a cache for every later step, and one OpenEXR picture per light for viewing. Captures of
/// several lights at once are demultiplexed with a clean plate, so this is in relight, which
/// has clean plates.

namespace haarlight::relight {

struct DevelopSessionOptions {
  std::string session;
  session::Demosaic demosaic = session::Demosaic::bilinear;
  session::RadiometryOptions radiometry;  ///< its steps, flat field and limits
  std::optional<Transfer> unknown_as;     ///< for the unknown curve of a camera's YUYV or NV12
  /// The clean plate that distributes the light of several lights at once: as
  /// PlateChoice::parse, or "even": equally; empty: computed from the session's rig.
  std::string plate;
  std::string exr;    ///< folder of one picture per light; empty: none
  std::string cache;  ///< folder instead of SESSION/cache
  /// Standard errors too, -1 where a value was clipped in every exposure.
  bool has_standard_error = false;
  PipelineSettings settings;  ///< `overwrites`: the cache is rebuilt, too
};

struct DevelopSummary {
  StackDims dims;                   ///< of the stack
  int n_bands = 0;                  ///< in the stack
  std::uint64_t n_saturated = 0;    ///< values that are lower bounds
  double moved_fraction = 0.0;      ///< of compared values that contradict each other
  std::string record;               ///< the steps taken
  std::string cache;                ///< where the stack is kept
  std::uint64_t bytes = 0;          ///< of the stack and the pictures
  std::vector<PipelineNote> notes;  ///< all messages
};

/// @throws Error  a session or plate that cannot be read, steps that it refuses, an output that
///                exists
[[nodiscard]] DevelopSummary develop_session(const DevelopSessionOptions& options);

/// What was requested and achieved.
void add_to_report(const DevelopSessionOptions& options, const DevelopSummary& summary,
                   Report& report);

}  // namespace haarlight::relight
