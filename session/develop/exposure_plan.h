// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <vector>

#include "core/rig/pattern_inverse.h"
#include "haarlight/session/session.h"

/// @file
/// Which frames of a session measure what: the light shots grouped by pattern, how each is
/// scaled, and how single lights are recovered from the groups. From session.json alone; reads
/// no pixels. Pure.

namespace haarlight::session {

/// A frame's role in a measurement: linear signal / scale = radiance at unit drive and power.
struct ScaledFrame {
  const FrameRecord* frame = nullptr;
  double scale = 1.0;  ///< exposure in s * 10^(gain_db/20) [* drive * power]
};

/// Exposures of one pattern.
struct PatternGroup {
  std::vector<LightLevel> lit;
  std::vector<ScaledFrame> frames;
};

struct ExposurePlan {
  /// One per light, in order, when single; otherwise one per pattern.
  std::vector<PatternGroup> groups;
  bool is_single = true;  ///< every group is one light: nothing to demultiplex
  /// From the groups, in their order, to the lights times their relative powers; null when
  /// single.
  std::shared_ptr<const PatternInverse> inverse;
  std::vector<const FrameRecord*> dark;
  std::vector<const FrameRecord*> flat;
  std::vector<const FrameRecord*> sentinels;
};

/// @throws Error  a light that no committed shot lights, patterns that do not separate the
///     lights
[[nodiscard]] ExposurePlan plan_exposures(const Session& session);

}  // namespace haarlight::session
