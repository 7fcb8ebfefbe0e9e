// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

/// @file
/// Faces of a mesh's cells by their smallest node: of each node there are few, so that those that are
/// alike are found in time that grows as the cells.

namespace haarlight::render {

template <class Face>
struct FaceBuckets {
  std::vector<Face> faces;
  std::vector<std::size_t> ends;  ///< (n_nodes,) where the faces of each smallest node end
};

/// @param for_each  called with visit(smallest_node, make), for each face once; twice alike. make() is
///                  the face
template <class Face, class ForEach>
[[nodiscard]] FaceBuckets<Face> faces_by_node(std::size_t n_nodes, const ForEach& for_each) {
  FaceBuckets<Face> buckets;
  buckets.ends.assign(n_nodes, 0);
  for_each([&](std::size_t smallest, const auto& /*make*/) { ++buckets.ends[smallest]; });
  std::size_t n = 0;
  for (std::size_t& end : buckets.ends) {
    n += std::exchange(end, n);
  }
  buckets.faces.resize(n);
  for_each([&](std::size_t smallest, const auto& make) {
    buckets.faces[buckets.ends[smallest]++] = make();
  });
  return buckets;
}

}  // namespace haarlight::render
