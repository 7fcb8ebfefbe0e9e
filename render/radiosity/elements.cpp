// SPDX-License-Identifier: Apache-2.0
#include "render/radiosity/elements.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace haarlight::render {

void Elements::split(std::size_t side, std::vector<Seen> seen) {
  within_[side] = static_cast<std::uint32_t>(size());
  split_.push_back({.side = side, .seen = std::move(seen)});
}

std::size_t Elements::of(std::size_t side, std::optional<Seen> other_end) const {
  if (within_[side] == 0 || !other_end) {
    return side;
  }
  const Split& split = split_[within_[side] - n_sides()];
  return std::ranges::binary_search(split.seen, *other_end) ? within_[side] : side;
}

namespace {

/// Points that see something in common, and all that they see, ascending.
struct Group {
  std::size_t n_points = 0;
  SeenFromPoint seen;
};

std::vector<Group> groups_of(std::span<const SeenFromPoint> points) {
  std::vector<Group> groups;
  for (const SeenFromPoint& point : points) {
    Group joined{.n_points = 1, .seen = point};
    std::ranges::sort(joined.seen);
    std::vector<Group> others;
    for (Group& group : groups) {
      SeenFromPoint common;
      std::ranges::set_intersection(joined.seen, group.seen, std::back_inserter(common));
      if (common.empty()) {
        others.push_back(std::move(group));
        continue;
      }
      SeenFromPoint both;
      std::ranges::set_union(joined.seen, group.seen, std::back_inserter(both));
      joined = {.n_points = joined.n_points + group.n_points, .seen = std::move(both)};
    }
    others.push_back(std::move(joined));
    groups = std::move(others);
  }
  return groups;
}

}  // namespace

std::size_t n_groups(std::span<const SeenFromPoint> points) { return groups_of(points).size(); }

std::optional<std::vector<Seen>> seen_within(std::span<const SeenFromPoint> points) {
  const std::vector<Group> groups = groups_of(points);
  if (groups.size() < 2 ||
      std::ranges::any_of(groups, [](const Group& group) { return group.n_points < 2; })) {
    return std::nullopt;
  }
  // Nothing is the least.
  const auto openness = [](const Group& group) {
    return std::pair(!group.seen.front(), group.seen.size());
  };
  const auto without = std::ranges::max_element(
      groups, [&](const Group& a, const Group& b) { return openness(a) < openness(b); });
  std::vector<Seen> seen;
  for (auto group = groups.begin(); group != groups.end(); ++group) {
    for (const std::optional<Seen>& side : group->seen) {
      if (group != without && side) {
        seen.push_back(*side);
      }
    }
  }
  std::ranges::sort(seen);
  return seen;
}

}  // namespace haarlight::render
