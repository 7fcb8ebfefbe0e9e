// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>

/// @file
/// How long the sums of shadow_points.h take, estimated from counts: a result must not depend
/// on a clock.

namespace haarlight::relight {

struct SumEffort {
  std::uint64_t n_lookups = 0;  ///< of shadow pictures
  std::uint64_t n_asked = 0;    ///< answers of the occluder

  void add(const SumEffort& other) {
    n_lookups += other.n_lookups;
    n_asked += other.n_asked;
  }
  // In look-ups of single lights, 0.3 us each on the machine where the factors were measured: a
  // shadow hull answers for one light in the time of twelve; a block's cone is wider and needs
  // more rays, its irradiance four Gauss points.
  [[nodiscard]] double light_by_light() const {
    return static_cast<double>(n_lookups) + 12.0 * static_cast<double>(n_asked);
  }
  [[nodiscard]] double by_blocks() const {
    return 2.0 * static_cast<double>(n_lookups) + 48.0 * static_cast<double>(n_asked);
  }
};

}  // namespace haarlight::relight
