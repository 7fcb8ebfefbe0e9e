// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "haarlight/session/develop/develop_options.h"
#include "session/develop/bad_pixels.h"
#include "session/develop/dark_model.h"

/// @file
/// The pixels' relative sensitivity, from frames of an evenly lit target.

namespace haarlight::session {

struct FlatField {
  Image<float> relative;  ///< mean 1 over the good pixels of each colour; empty: none
  int n_frames = 0;
  double least = 1.0;
  double greatest = 1.0;
  double relative_variance = 0.0;  ///< of a typical pixel, from the flat frames' own noise
};

/// Mean of the frames, dark subtracted; marks pixels below 2 % of the mean as dead.
/// @throws Error  more than 0.1 % of the samples are clipped, no light in the frames
[[nodiscard]] FlatField measure_flat(const Session& session,
                                     const std::vector<const FrameRecord*>& frames,
                                     const DarkModel& dark, const Lineariser& linear,
                                     const SensorResponse& response, FlatKind kind,
                                     BadPixelMap& bad);

}  // namespace haarlight::session
