// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <Eigen/Core>

/// @file
/// Neighbouring lights in groups. What a model gets wrong it gets wrong alike for lights that
/// stand together, so that only leaving a whole group out shows what it does to a result.

namespace haarlight {

/// Groups of a jackknife: with more of them each is smaller and errors that neighbours share
/// show less; with fewer the spread between them is itself ill known (1/sqrt(2 x 11): 21 %).
inline constexpr int kLightGroups = 12;

struct LightGroups {
  std::vector<int> group;  ///< (n_lights) 0 to n_groups - 1
  std::vector<int> order;  ///< the lights, group after group
  int n_groups = 0;
};

/// By direction: seeds as far from each other as can be, each light with its nearest. As many
/// groups as lights where these are few.
/// @param directions  (n_lights) unit
[[nodiscard]] LightGroups group_lights(const std::vector<Eigen::Vector3d>& directions,
                                       int most = kLightGroups);

/// About `n` of the lights, group after group, each group's share alike; all where these are
/// fewer.
[[nodiscard]] std::vector<int> thinned(const LightGroups& groups, int n);

}  // namespace haarlight
