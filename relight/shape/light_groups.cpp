// SPDX-License-Identifier: Apache-2.0
#include "relight/shape/light_groups.h"

#include <algorithm>
#include <cstdint>
#include <numeric>

#include "core/count.h"
#include "haarlight/core/error.h"

namespace haarlight::relight {

namespace {

using Eigen::Vector3d;

}  // namespace

LightGroups group_lights(const std::vector<Vector3d>& directions, int most) {
  HAARLIGHT_EXPECTS(!directions.empty() && most >= 1, "lights to group");
  const std::size_t n = directions.size();
  LightGroups groups;
  groups.group.assign(n, 0);
  std::vector<double> nearest(n, -2.0);  // cosine to the nearest seed
  std::size_t seed = 0;
  while (groups.n_groups < most && groups.n_groups < static_cast<int>(n)) {
    const Vector3d& at = directions[seed];
    for (std::size_t k = 0; k < n; ++k) {
      const double cosine = directions[k].dot(at);
      if (cosine > nearest[k]) {
        nearest[k] = cosine;
        groups.group[k] = groups.n_groups;
      }
    }
    nearest[seed] = 2.0;  // its own, even if two lights coincide
    groups.group[seed] = groups.n_groups;
    ++groups.n_groups;
    seed = static_cast<std::size_t>(std::min_element(nearest.begin(), nearest.end()) -
                                    nearest.begin());
  }
  groups.order.resize(n);
  std::iota(groups.order.begin(), groups.order.end(), 0);
  std::stable_sort(groups.order.begin(), groups.order.end(), [&](int a, int b) {
    return groups.group[count(a)] < groups.group[count(b)];
  });
  return groups;
}

std::vector<int> thinned(const LightGroups& groups, int n) {
  const int n_lights = static_cast<int>(groups.order.size());
  if (n >= n_lights) {
    return groups.order;
  }
  std::vector<int> some;
  some.reserve(count(n));
  for (int i = 0; i < n; ++i) {
    some.push_back(groups.order[static_cast<std::size_t>(std::int64_t{i} * n_lights / n)]);
  }
  return some;
}

}  // namespace haarlight::relight
