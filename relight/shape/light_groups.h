// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Core>

/// @file
/// Neighbouring lights in groups. Model errors are alike for lights close together, so that
/// only leaving out a whole group shows their effect on a result.

namespace haarlight::relight {

/// Groups of a jackknife: more and smaller ones show less of the errors common to neighbours;
/// with fewer, their spread is itself poorly known (1/sqrt(2 x 11): 21 %).
inline constexpr int kLightGroups = 12;

struct LightGroups {
  std::vector<int> group;  ///< (n_lights) 0 to n_groups - 1
  std::vector<int> order;  ///< the lights, group after group
  int n_groups = 0;
};

/// By direction: farthest-point seeds, each light with its nearest. As many groups as lights if
/// these are few.
/// @param directions  (n_lights) unit
[[nodiscard]] LightGroups group_lights(const std::vector<Eigen::Vector3d>& directions,
                                       int most = kLightGroups);

/// About `n` of the lights, group after group, in proportion; all if there are fewer.
[[nodiscard]] std::vector<int> thinned(const LightGroups& groups, int n);

}  // namespace haarlight::relight
