// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <Eigen/Core>

/// @file
/// Boxes about boxes about a scene's triangles, to find in double precision those that a ray
/// or a box may meet. It holds no triangles, only their numbers.

namespace haarlight::render {

class FaceTree {
 public:
  FaceTree() = default;

  /// @param corners  of each face, numbers of `vertices`
  FaceTree(std::span<const Eigen::Vector3d> vertices,
           std::span<const std::array<std::uint32_t, 3>> corners);

  /// Calls `function(face)` for all faces of each box about a few that may be reached, in an order that
  /// depends on the faces alone, until one answers true.
  /// @param reaches  bool(low, high), of 3 floats: whether something in that box may be
  /// @return whether one did
  template <typename Reaches, typename Function>
  [[nodiscard]] bool any(const Reaches& reaches, const Function& function) const {
    for (std::size_t i = 0; i < nodes_.size();) {
      const Node& node = nodes_[i];
      if (!reaches(node.low, node.high)) {
        i = node.next;
        continue;
      }
      for (std::uint32_t k = node.first; k < node.last; ++k) {
        if (function(faces_[k])) {
          return true;
        }
      }
      ++i;
    }
    return false;
  }

 private:
  /// Depth first: the first child comes next, and after all below it `next`.
  struct Node {
    std::array<float, 3> low;
    std::array<float, 3> high;
    std::uint32_t next = 0;
    std::uint32_t first = 0;  ///< of a leaf's faces
    std::uint32_t last = 0;
  };
  struct Item {
    std::array<float, 3> low;  ///< rounded outwards
    std::array<float, 3> high;
    std::uint32_t face;
  };
  void build(std::span<Item> items);

  std::vector<Node> nodes_;
  std::vector<std::uint32_t> faces_;
};

}  // namespace haarlight::render
