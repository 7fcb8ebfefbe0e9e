// SPDX-License-Identifier: Apache-2.0
#include "render/soft_shadow/face_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace haarlight::render {

namespace {

using Eigen::Vector3d;

constexpr std::size_t kMostFaces = 4;  // of a leaf

}  // namespace

FaceTree::FaceTree(std::span<const Vector3d> vertices,
                   std::span<const std::array<std::uint32_t, 3>> corners) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  std::vector<Item> items;
  items.reserve(corners.size());
  for (const std::array<std::uint32_t, 3>& face : corners) {
    const Vector3d& a = vertices[face[0]];
    const Vector3d& b = vertices[face[1]];
    const Vector3d& c = vertices[face[2]];
    const Vector3d low = a.cwiseMin(b).cwiseMin(c);
    const Vector3d high = a.cwiseMax(b).cwiseMax(c);
    Item& item = items.emplace_back();
    item.face = static_cast<std::uint32_t>(items.size() - 1);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto at = static_cast<Eigen::Index>(axis);
      item.low.at(axis) = std::nextafter(static_cast<float>(low[at]), -kInfinity);
      item.high.at(axis) = std::nextafter(static_cast<float>(high[at]), kInfinity);
    }
  }
  faces_.reserve(items.size());
  nodes_.reserve(items.size());
  if (!items.empty()) {
    build(items);
  }
}

/// Halves along the longest side of the box about their middles.
void FaceTree::build(std::span<Item> items) {
  const std::size_t number = nodes_.size();
  Node& node = nodes_.emplace_back();
  node.low = items.front().low;
  node.high = items.front().high;
  std::size_t longest = 0;
  float length = -1.0F;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    float first = items.front().low.at(axis) + items.front().high.at(axis);
    float last = first;
    for (const Item& item : items) {
      node.low.at(axis) = std::min(node.low.at(axis), item.low.at(axis));
      node.high.at(axis) = std::max(node.high.at(axis), item.high.at(axis));
      first = std::min(first, item.low.at(axis) + item.high.at(axis));
      last = std::max(last, item.low.at(axis) + item.high.at(axis));
    }
    if (last - first > length) {
      length = last - first;
      longest = axis;
    }
  }
  if (items.size() <= kMostFaces) {
    node.first = static_cast<std::uint32_t>(faces_.size());
    for (const Item& item : items) {
      faces_.push_back(item.face);
    }
    node.last = static_cast<std::uint32_t>(faces_.size());
  } else {
    const auto half = static_cast<std::ptrdiff_t>(items.size() / 2);
    std::nth_element(items.begin(), items.begin() + half, items.end(),
                     [longest](const Item& a, const Item& b) {
                       const float of_a = a.low[longest] + a.high[longest];
                       const float of_b = b.low[longest] + b.high[longest];
                       return of_a < of_b || (of_a == of_b && a.face < b.face);
                     });
    build(items.first(items.size() / 2));
    build(items.subspan(items.size() / 2));
  }
  nodes_[number].next = static_cast<std::uint32_t>(nodes_.size());
}

}  // namespace haarlight::render
