// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <vector>

#include "session/develop/dark_model.h"

/// @file
/// How the rig's brightness drifts during a session, from the sentinel light's frames:
///
///     b_k = (sum s_k / E_k) / (sum s_0 / E_0),    g_k = b_k / median b
///
/// the sums over the pixels that are not clipped in either; the best ratio under photon noise.
/// The median, not the first: it is near the settled brightness after a warm-up, and a lamp
/// that fails at the end does not move it. Linear in time between sentinels. A sentinel sees
/// what is common to all lights (supply, ambient temperature, the camera's gain), not what one
/// LED does by itself.

namespace haarlight::session {

struct DriftGain {
  double gain = 1.0;   ///< brightness relative to the median of the sentinels
  double sigma = 0.0;  ///< standard error: the sentinels' noise, and a quarter of the curvature
};

class DriftModel {
 public:
  DriftModel() = default;
  /// @param sentinels  at least one, by time
  /// @throws Error  a sentinel without light
  DriftModel(const Session& session, const std::vector<const FrameRecord*>& sentinels,
             const DarkModel& dark, const Lineariser& linear, const SensorResponse& response);

  [[nodiscard]] bool is_empty() const { return points_.empty(); }
  [[nodiscard]] DriftGain at(std::int64_t time) const;
  [[nodiscard]] int n_sentinels() const { return static_cast<int>(points_.size()); }
  [[nodiscard]] double least() const;
  [[nodiscard]] double greatest() const;
  /// Between two successive sentinels.
  [[nodiscard]] double largest_step() const;
  [[nodiscard]] double largest_sigma() const;

 private:
  struct Point {
    std::int64_t time = 0;
    double gain = 1.0;
    double sigma = 0.0;
  };
  /// Second difference of the gains around segment [i, i + 1], 0 for fewer than three.
  [[nodiscard]] double bend(std::size_t i) const;

  std::vector<Point> points_;
};

}  // namespace haarlight::session
