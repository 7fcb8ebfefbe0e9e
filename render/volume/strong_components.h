// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

/// @file
/// Sets of a directed graph's nodes that lead to each other, by one depth-first search [Tarjan72].

namespace haarlight::render {

/// @param successors_of  (node) -> span of the nodes that its edges lead to
/// @param visit          (span of the nodes of a component), those first that edges lead to
/// O(nodes + edges); without recursion.
template <class SuccessorsOf, class Visit>
void for_each_component(std::size_t n_nodes, const SuccessorsOf& successors_of,
                        const Visit& visit) {
  constexpr std::uint32_t kNew = std::numeric_limits<std::uint32_t>::max();
  constexpr std::uint32_t kDone = kNew - 1;
  struct Step {
    std::uint32_t node;
    std::uint32_t next;  ///< of its successors
    std::uint32_t number;
    std::uint32_t lowest;  ///< number that was reached
  };
  std::vector<std::uint32_t> numbers(n_nodes, kNew);
  std::vector<std::uint32_t> open;
  std::vector<Step> way;
  std::uint32_t n_numbered = 0;
  const auto enter = [&](std::uint32_t node) {
    numbers[node] = n_numbered;
    open.push_back(node);
    way.push_back({.node = node, .next = 0, .number = n_numbered, .lowest = n_numbered});
    ++n_numbered;
  };
  for (std::uint32_t root = 0; root < n_nodes; ++root) {
    if (numbers[root] != kNew) {
      continue;
    }
    enter(root);
    while (!way.empty()) {
      Step& step = way.back();
      const std::span<const std::uint32_t> successors = successors_of(step.node);
      if (step.next < successors.size()) {
        const std::uint32_t successor = successors[step.next++];
        if (numbers[successor] == kNew) {
          enter(successor);
        } else if (numbers[successor] != kDone) {
          step.lowest = std::min(step.lowest, numbers[successor]);
        }
        continue;
      }
      const Step done = step;
      way.pop_back();
      if (!way.empty()) {
        way.back().lowest = std::min(way.back().lowest, done.lowest);
      }
      if (done.lowest == done.number) {
        std::size_t first = open.size();
        do {
          --first;
          numbers[open[first]] = kDone;
        } while (open[first] != done.node);
        visit(std::span<const std::uint32_t>(open).subspan(first));
        open.resize(first);
      }
    }
  }
}

}  // namespace haarlight::render
