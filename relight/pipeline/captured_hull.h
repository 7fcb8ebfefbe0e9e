// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "core/report.h"
#include "relight/hull/shadow_hull.h"
#include "relight/pipeline/pipeline_settings.h"
#include "relight/pipeline/shadow_captures.h"

/// @file
/// The shadow hull of the captures of one object. Carving needs every light's shadow picture, so
/// that the result is kept next to the basis file and read again as long as nothing that it
/// came from has changed.

namespace haarlight::relight {

/// What a hull is, and where it came from.
struct HullSource {
  HullSummary hull;
  std::string file;       ///< where it is kept; empty: it could not be written
  bool is_carved = true;  ///< now; false: read from `file`
};

struct CapturedHull {
  ShadowHull hull;
  HullSource source;
};

/// @param voxel_mm  0: chosen (relight/hull/shadow_hull.h)
/// @param told      why it could not be kept; a plane that does not fit the rig
/// @throws Error    as ShadowCaptures, build_hull
[[nodiscard]] CapturedHull captured_hull(const CapturedObject& captured, double voxel_mm,
                                         const PipelineSettings& settings, PipelineNotes& told);

/// Lines of text: what it is, how much of it is assumed, where it is kept.
[[nodiscard]] std::string hull_words(const HullSource& hull);

void add_to_report(const HullSource& hull, Report& report);

}  // namespace haarlight::relight
