// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "haarlight/core/rig/rig.h"
#include "sim/truth.h"

/// @file
/// A rig file that is wrong in every value that commissioning measures, and what is true
/// instead.

namespace haarlight::testing {

inline constexpr double kReadUs = 12000.0;
inline constexpr double kSkewUs = 9000.0;

/// One of six.
struct CommissionedCamera {
  TimestampMeaning meaning;
  Shutter shutter;
};

/// What the rig file claims: right in nothing that is to be measured.
inline Rig written_rig(Shutter shutter) {
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  CameraSpec& c = rig.cameras[0];
  c.fps = 40.0;
  c.exposure_us = 6000.0;
  c.shutter = shutter;
  c.skew_us = shutter == Shutter::rolling ? 1000.0 : 0.0;
  c.read_us = 1000.0;
  c.timestamp = TimestampMeaning::end_frame;
  c.noise = {2.0, 10.0, 30000.0, 64.0};
  return rig;
}

inline sim::SimTruth truth_of(const CommissionedCamera& which) {
  sim::SimTruth t;
  t.latch_us = 812.0;
  t.rise_us = 140.0;
  t.fall_us = 60.0;
  sim::CameraTruth c;
  c.id = "main";
  c.timestamp = which.meaning;
  c.shutter = which.shutter;
  c.skew_us = which.shutter == Shutter::rolling ? kSkewUs : 0.0;
  c.read_us = kReadUs;
  c.exposure_delay_frames = 2;
  c.noise = SensorNoise{0.92, 4.1, 14500.0, 200.0};
  t.cameras.push_back(c);
  t.dead = {9, 41};
  t.dim = {{12, 0.6}, {50, 1.25}};
  t.swapped = {{20, 21}};
  return t;
}

}  // namespace haarlight::testing
