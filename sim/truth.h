// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "haarlight/core/rig/rig.h"
#include "sim/virtual_camera.h"

/// @file
/// What a virtual rig really is where that differs from its rig file: what commissioning has to
/// find. Written as TOML, see docs/reference/simulator.md.

namespace haarlight::sim {

/// Everything that is set replaces the rig file's value.
struct CameraTruth {
  std::string id;
  std::optional<TimestampMeaning> timestamp;
  std::optional<Shutter> shutter;
  std::optional<double> skew_us;
  std::optional<double> read_us;
  std::optional<int> exposure_delay_frames;
  std::optional<SensorNoise> noise;
  /// Of the sensor; the LEDs' warm-up is in SimTruth.
  RigFlaws flaws;
};

struct SimTruth {
  std::optional<double> latch_us;
  std::optional<double> rise_us;
  std::optional<double> fall_us;
  double latch_spread_us = 0.0;  ///< see RigFlaws
  double ramp_spread_us = 0.0;
  std::vector<CameraTruth> cameras;
  double warm_up = 0.0;  ///< see RigFlaws
  double warm_up_s = 60.0;
  std::vector<int> dead;
  std::vector<std::pair<int, double>> dim;   ///< light, relative power
  std::vector<std::pair<int, int>> swapped;  ///< each shines from the other's position
};

/// @throws Error  every problem with file:line and a hint; lights or cameras that the rig does
///     not have
[[nodiscard]] SimTruth read_truth(const std::filesystem::path& path, const Rig& rig);
[[nodiscard]] SimTruth parse_truth(const std::string& text, const std::string& name,
                                   const Rig& rig);

/// The rig as it really is.
[[nodiscard]] Rig apply_truth(const SimTruth& truth, Rig rig);
/// Further flaws in what a camera of the rig sees.
[[nodiscard]] RigFlaws true_flaws(const SimTruth& truth, const std::string& camera_id);
/// By position: of the LED where light k should be. Empty when all are 1.
[[nodiscard]] std::vector<double> true_light_power(const SimTruth& truth, int n_lights);
/// Element k lights the LED at position wiring[k]. Empty when each lights its own.
[[nodiscard]] std::vector<int> true_wiring(const SimTruth& truth, int n_lights);

}  // namespace haarlight::sim
