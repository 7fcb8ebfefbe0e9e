// SPDX-License-Identifier: Apache-2.0
#include "relight/shadow/light_balls.h"

#include <cmath>
#include <limits>
#include <numeric>

namespace haarlight::relight {

namespace {

constexpr int kMostLights = 16;  // per ball

}  // namespace

LightBalls light_balls(const render::LightRoot& root) {
  std::vector<int> n_leaves(root.nodes.size(), 1);
  for (std::size_t at = root.nodes.size(); at-- > 0;) {
    const render::LightNode& node = root.nodes[at];
    if (node.n_children > 0) {
      const auto first = n_leaves.begin() + node.first_child;
      n_leaves[at] = std::accumulate(first, first + node.n_children, 0);
    }
  }
  LightBalls found;
  constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
  std::vector<std::size_t> ball_of(root.nodes.size(), kNone);
  for (std::size_t at = 0; at < root.nodes.size(); ++at) {
    const render::LightNode& node = root.nodes[at];
    if (ball_of[at] == kNone && n_leaves[at] <= kMostLights) {
      ball_of[at] = found.balls.size();
      const render::SquareLight& one = root.nodes[static_cast<std::size_t>(node.member)].block;
      found.balls.push_back({node.centres.centre,
                             0.5 * (std::hypot(node.centres.width_mm, node.centres.height_mm) +
                                    std::hypot(one.width_mm, one.height_mm))});
    }
    for (int c = 0; c < node.n_children; ++c) {
      const int child = node.first_child + c;
      ball_of[static_cast<std::size_t>(child)] = ball_of[at];
    }
  }
  for (const int leaf : root.leaves) {
    found.of_leaf.push_back(ball_of[static_cast<std::size_t>(leaf)]);
  }
  return found;
}

}  // namespace haarlight::relight
